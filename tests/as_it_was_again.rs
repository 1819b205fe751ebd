//! A recording as a black box: the poses that a set published live, stages killed and all, are computed again to the bit; a changed
//! byte is seen, and what a recording lacks is named.

use crate::recorder::Recorder;
use crate::support::{RunningSet, flockslam, run_well, send, simulated_log, stderr, stdout, wait_for};
use flockslam_messages::{PoseFlags, ScanBuffer, ScanHeader, Stage};
use flockslam_recordings::SetRecord;
use mcap::read::MessageStream;
use mcap::{Message, WriteOptions};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Scans of the drive: ten a second of its time.
const SCANS: u64 = 450;
/// Stages that are killed, and after how many scans.
const KILLS: [(u64, Stage); 5] = [
    (100, Stage::ScanMatcher),
    (170, Stage::Mapper),
    (230, Stage::DynamicCleaner),
    (290, Stage::Mapper),
    (350, Stage::ScanMatcher),
];

/// A live drive with a recorder beside it, some of whose stages are killed: the log of the drive, the recording, and the published
/// trajectory.
fn recorded_drive(place: &Path) -> (PathBuf, PathBuf, Vec<u8>) {
    let args = ["map", "--source", "-", "--live", "--set", "page.enabled=false"].map(str::to_owned);
    let mut set = RunningSet::start_with_pipe("black-box", &place.join("seen"), &args);
    for stage in [Stage::SyncManager, Stage::ScanMatcher] {
        set.pid(stage);
    }
    let file = place.join("drive.mcap");
    let mut recorder = Recorder::of_robot(set.robot(), &[file.to_str().unwrap()]);
    wait_for("the recorder", || file.exists().then_some(()));
    let (log, mut stdin) = (simulated_log(SCANS as f64 / 10.0), set.stdin.take().unwrap());
    let mut scans = 0;
    for line in log.lines() {
        writeln!(stdin, "{line}").unwrap();
        scans += u64::from(line.starts_with("ROBOTLASER"));
        for (_, stage) in KILLS.iter().filter(|(after, _)| *after == scans) {
            let killed = set.pid(*stage);
            send(killed, Signal::KILL);
            wait_for("a successor", || Some(set.pid(*stage)).filter(|pid| *pid != killed));
        }
        // Ten times as fast as its sensor, and slow enough for a stage to be started again.
        std::thread::sleep(Duration::from_millis(10));
    }
    drop(stdin);
    let mut said = String::new();
    recorder.0.stdout.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(said.contains("recorded"), "{said}");
    let seen = set.finish();
    let restarts: u64 = seen.report.stages.values().map(|stage| stage.restarts).sum();
    assert_eq!(restarts, KILLS.len() as u64, "{:?}", seen.report.stages);
    fs::write(place.join("drive.log"), log).unwrap();
    (place.join("drive.log"), file, seen.bytes("trajectory_online.tum"))
}

/// Runs a recording again; exit code, what it said, its poses and its report.
fn as_it_was(recording: &Path, out: &Path) -> (Option<i32>, String, Vec<u8>, Value) {
    let mut command = flockslam();
    let output = command.arg("map").arg(recording).arg("--as-it-was").arg("--out").arg(out).output().unwrap();
    let read = |name: &str| fs::read(out.join(name)).unwrap_or_default();
    let report = serde_json::from_slice(&read("as_it_was.json")).unwrap_or_default();
    (output.status.code(), stdout(&output) + &stderr(&output), read("trajectory_online.tum"), report)
}

/// A copy of a recording with other messages: `change` gives what becomes of each.
fn rewritten(recording: &Path, to: &Path, mut change: impl FnMut(Message<'_>) -> Option<Message<'_>>) {
    let bytes = fs::read(recording).unwrap();
    let mut writer = WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    for message in MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        if let Some(message) = change(message) {
            writer.write(&message).unwrap();
        }
    }
    writer.finish().unwrap();
    fs::write(to, writer.into_inner().into_inner()).unwrap();
}

fn record_of(message: &Message<'_>) -> Option<SetRecord> {
    SetRecord::from_bytes(&message.data).filter(|_| message.channel.topic == "/flockslam/set")
}

/// The first scan from this one on that has entered the map.
fn first_accepted_after(recording: &Path, scan: u64) -> u64 {
    let bytes = fs::read(recording).unwrap();
    let poses =
        MessageStream::new(&bytes).unwrap().filter_map(|message| match record_of(&message.unwrap())? {
            SetRecord::Pose(pose) if pose.has(PoseFlags::INSERT) => Some(pose.id.sequence),
            _ => None,
        });
    poses.filter(|sequence| *sequence >= scan).min().unwrap()
}

/// The first line in which two trajectories differ.
fn first_difference(computed: &[u8], published: &[u8]) -> String {
    let lines = |bytes: &[u8]| String::from_utf8_lossy(bytes).lines().map(str::to_owned).collect::<Vec<_>>();
    let (computed, published) = (lines(computed), lines(published));
    let at = (0..).find(|line| computed.get(*line) != published.get(*line) || *line >= computed.len());
    let at = at.unwrap_or_default();
    format!(
        "line {at} of {} computed: {:?}; of {} published: {:?}",
        computed.len(),
        computed.get(at),
        published.len(),
        published.get(at)
    )
}

fn scan_of(message: &Message<'_>) -> Option<u64> {
    let is_scan = message.channel.topic == "/flockslam/scan";
    is_scan.then(|| ScanBuffer::from_bytes(&message.data).unwrap().header.id.sequence)
}

#[test]
fn the_poses_of_a_recorded_drive_with_killed_stages_are_computed_again_to_the_bit() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let (log, file, published) = recorded_drive(place);

    let (code, said, poses, report) = as_it_was(&file, &place.join("again"));
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("exact: every pose is the published one"), "{said}");
    assert!(poses == published, "{}\n{said}", first_difference(&poses, &published));
    assert!(report["restarts"].as_u64() >= Some(4), "{report}");
    assert_eq!(report["equal"], report["poses"]);

    // Without it the recording is a log like any other: the map is that of an exact replay of the same scans.
    let replayed = |recording: &Path| {
        let args = ["map".to_owned(), recording.display().to_string()];
        let outputs = run_well("bb-replay", &place.join("replayed"), &args);
        (outputs.bytes("trajectory.tum"), outputs.bytes("map.pgm"))
    };
    assert!(replayed(&file) == replayed(&log));

    // One byte in the ranges of one scan that was matched.
    let matched = first_accepted_after(&file, SCANS / 3);
    let changed = place.join("changed.mcap");
    rewritten(&file, &changed, |mut message| {
        if scan_of(&message) == Some(matched) {
            let scan = ScanBuffer::from_bytes(&message.data).unwrap();
            let near = scan.numbers.iter().position(|range_m| (1.0..6.0).contains(range_m)).unwrap();
            message.data.to_mut()[size_of::<ScanHeader>() + 4 * near + 2] ^= 0x40;
        }
        Some(message)
    });
    let (code, said, poses, report) = as_it_was(&changed, &place.join("changed"));
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("not exact") && poses != published, "{said}");
    let first = report["first_difference"]["scan"].as_u64().unwrap();
    assert!(
        (matched..matched + 5).contains(&first) && report["gaps"] == Value::Array(Vec::new()),
        "{report}"
    );

    // A scan, a commit, and the inputs of a scan are missing, all before the first kill.
    let lost = first_accepted_after(&file, 80);
    let (lacking, mut commits, mut inputs) = (place.join("lacking.mcap"), 0, 0);
    rewritten(&file, &lacking, |message| {
        let record = record_of(&message);
        match record {
            Some(SetRecord::Commit(_)) => commits += 1,
            Some(SetRecord::Inputs(record)) if record.stage == Stage::ScanMatcher as u32 => inputs += 1,
            _ if scan_of(&message) == Some(lost) => return None,
            _ => return Some(message),
        }
        let is_missing = (commits == 12 && matches!(record, Some(SetRecord::Commit(_))))
            || (inputs == 60 && matches!(record, Some(SetRecord::Inputs(_))));
        (!is_missing).then_some(message)
    });
    let (code, said, _, report) = as_it_was(&lacking, &place.join("lacking"));
    assert_eq!(code, Some(1), "{said}");
    for gap in [
        &format!("gap: scan {lost} is missing"),
        "gap: 1 commits before",
        "gap: what scan-matcher used for 1 scans before",
    ] {
        assert!(said.contains(gap), "{gap}: {said}");
    }
    assert!(!said.contains("exact: every pose") && report["gaps"].as_array().unwrap().len() >= 3, "{said}");

    // The start is missing.
    let late = place.join("late.mcap");
    let is_early = |record: &SetRecord| match record {
        SetRecord::Inputs(inputs) => inputs.id.sequence < 50,
        SetRecord::Pose(pose) => pose.id.sequence < 50,
        SetRecord::Commit(commit) => commit.id.sequence < 50,
        _ => false,
    };
    rewritten(&file, &late, |message| {
        let record = record_of(&message);
        let is_missing = record.is_some_and(|record| is_early(&record))
            || scan_of(&message).is_some_and(|sequence| sequence < 50);
        (!is_missing).then_some(message)
    });
    let (code, said, _, _) = as_it_was(&late, &place.join("late"));
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("gap: the recording begins with scan 50"), "{said}");

    // A log is none of a set, and settings are those of the drive.
    let (code, said, ..) = as_it_was(&log, &place.join("none"));
    assert!(code == Some(2) && said.contains("runs recordings by flockslam record again"), "{said}");
    let settings = ["map", file.to_str().unwrap(), "--as-it-was", "--set", "mapper.cell_size_m=0.1"];
    assert_eq!(flockslam().args(settings).output().unwrap().status.code(), Some(2));
}
