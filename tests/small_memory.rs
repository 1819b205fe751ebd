//! Little shared memory, little disk, few open files: a set is refused with the sizes, or drives on without a fault.

use crate::support;
use crate::support::small_mounts::{fill, flockslam_with, inside};
use crate::support::{
    Drive, LiveSet, Outputs, building, flockslam, live_building, machine_share, of, processes_of, robot,
    stderr, wait_for,
};
use flockslam_messages::Stage;
use flockslam_telemetry::{Beat, read_heartbeat};
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

const SHARED_MEMORY: &str = "/dev/shm";

fn run(mut command: Command, out: &Path, args: &[String]) -> Output {
    let robot = robot("small");
    let output = command.args(args).args(["--robot", &robot, "--out"]).arg(out).output().unwrap();
    support::assert_nothing_left(&robot);
    output
}

/// One line that has all these words.
fn refused(output: &Output, words: &[&str]) {
    let text = stderr(output);
    println!("{text}");
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    words.iter().for_each(|word| assert!(text.contains(word), "{word} is not in: {text}"));
}

#[test]
fn nine_megabytes_are_refused_with_what_is_needed() {
    let Some(command) = flockslam_with(Path::new(SHARED_MEMORY), "9m") else { return };
    let directory = tempfile::tempdir().unwrap();
    let output = run(command, directory.path(), &building(5));
    refused(&output, &["/dev/shm has 9.0 MB", "this set needs", "tiles", "--shm-size=32m"]);
}

#[test]
fn a_set_drives_in_what_a_container_has() {
    let Some(command) = flockslam_with(Path::new(SHARED_MEMORY), "64m") else { return };
    let directory = tempfile::tempdir().unwrap();
    let output = run(command, directory.path(), &building(900));
    assert!(output.status.success(), "{}", stderr(&output));
    let report = Outputs::read(directory.path()).report;
    println!("{:.1} MB of shared memory after 900 s", report.shared_memory_bytes as f64 / 1e6);
    assert!(report.stages.values().all(|stage| stage.restarts == 0), "{:?}", report.stages);
    assert!(report.shared_memory_bytes < 40 << 20, "{}", report.shared_memory_bytes);
}

/// A live run whose shared memory is its own.
struct Enclosed {
    child: Child,
    robot: String,
    shared_memory: PathBuf,
}

impl Enclosed {
    fn start(out: &Path, size: &str, args: &[String]) -> Option<Self> {
        let mut command = flockslam_with(Path::new(SHARED_MEMORY), size)?;
        let robot = robot("enclosed");
        command.args(args).args(["--robot", &robot, "--out"]).arg(out);
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
        let shared_memory = inside(child.id(), Path::new(SHARED_MEMORY));
        Some(Self { child, robot, shared_memory })
    }

    fn beat(&self, stage: Stage) -> Option<Beat> {
        let status = self.shared_memory.join(format!("flockslam-{}/status", self.robot));
        read_heartbeat(&flockslam_stage::heartbeat_file(&status, &format!("{}-0", stage.name()))).ok()?
    }

    fn wait_for(&self, what: &str, stage: Stage, is: impl Fn(&Beat) -> bool) -> Beat {
        wait_for(what, || self.beat(stage).filter(&is))
    }
}

impl Drop for Enclosed {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            let _ = self.child.kill();
            let _ = self.child.wait();
            wait_for("the death of all stages", || processes_of(&self.robot).is_empty().then_some(()));
        }
    }
}

#[test]
fn shared_memory_that_others_fill_stops_no_scan_and_a_stage_gets_up_when_there_is_room() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let Some(mut set) = Enclosed::start(directory.path(), "64m", &live_building(60, 3)) else { return };
    set.wait_for("some scans", Stage::Mapper, |beat| beat.handled > 3);
    let ballast = fill(&set.shared_memory);
    let full = set.beat(Stage::ScanMatcher).unwrap();
    let on = |beat: &Beat| beat.pid == full.pid && beat.handled > full.handled + 90;
    set.wait_for("poses in full memory", Stage::ScanMatcher, on);
    // What a dead process had is there for its successor, unless others take it.
    let mapper = set.beat(Stage::Mapper).unwrap();
    support::send(mapper.pid, Signal::KILL);
    let more = fill(&set.shared_memory);
    let now = set.beat(Stage::ScanMatcher).unwrap();
    let on = |beat: &Beat| beat.pid == now.pid && beat.handled > now.handled + 60;
    set.wait_for("poses without a mapper", Stage::ScanMatcher, on);
    assert_eq!(more, ballast);
    std::fs::remove_file(ballast).unwrap();
    set.wait_for("a mapper that works", Stage::Mapper, |beat| beat.pid != mapper.pid && beat.works);
    let status = wait_for("the end of the run", || set.child.try_wait().unwrap());
    assert_eq!(status.code(), Some(0));
    let report = Outputs::read(directory.path()).report;
    let others = report.stages.iter().filter(|(name, _)| *name != "mapper");
    others.for_each(|(name, stage)| assert_eq!(stage.restarts, 0, "{name}"));
    println!("{} restarts of the mapper", report.stages["mapper"].restarts);
}

#[test]
fn a_full_disk_under_the_journal_is_reported_and_poses_go_on() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let disk = directory.path().join("disk");
    std::fs::create_dir(&disk).unwrap();
    let Some(command) = flockslam_with(&disk, "1m") else { return };
    let config = directory.path().join("spill.toml");
    std::fs::write(&config, format!("[set]\nspill_dir = {:?}\n", disk.join("spill"))).unwrap();
    let drive = Drive { scan_rate_hz: 20.0, duration_s: 2000.0, rate: 4.0 };
    let mut set =
        LiveSet::start_by(command, "spilt", directory.path(), drive, &format!("config = {config:?}"));
    set.wait_until_handled(Stage::Mapper, 3);
    let ballast = fill(&inside(set.supervisor_pid(), &disk));
    let status = set.wait_until("a report of it", |status| status.not_durable.is_some());
    println!("{status}");
    assert!(status.to_string().contains("NOT DURABLE: ") && status.to_string().contains("cannot write in"));
    let before = of(&status, Stage::ScanMatcher).handled;
    let status = set.wait_until_handled(Stage::ScanMatcher, before + 1000);
    assert!(status.not_durable.is_some());
    assert!(status.stages.iter().all(|stage| stage.restarts == 0), "{status}");
    std::fs::remove_file(ballast).unwrap();
    set.wait_until("durability", |status| status.not_durable.is_none());
    let journal =
        inside(set.supervisor_pid(), &disk.join(format!("spill/flockslam-spill-{}/journal", set.robot())));
    let mut reader = flockslam_stage::JournalReader::open(&journal).unwrap();
    let mut poses = 0;
    while let Some(record) = reader.read_next().unwrap() {
        assert_eq!(record.pose.id.sequence, poses, "a pose is missing in the journal");
        poses += 1;
    }
    assert!(poses > before + 1000, "{poses} poses in the journal");
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

fn with_open_files(limit: &str) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", &format!("ulimit {limit} && exec \"$0\" \"$@\"")]).arg(flockslam().get_program());
    command
}

#[test]
fn few_open_files_are_refused_unless_more_are_allowed() {
    let directory = tempfile::tempdir().unwrap();
    let output = run(with_open_files("-n 64"), directory.path(), &building(5));
    refused(&output, &["needs 320 open files", "allows 64", "ulimit -n 320", "--ulimit nofile=320"]);
    let output = run(with_open_files("-Sn 64"), directory.path(), &building(5));
    assert!(output.status.success(), "{}", stderr(&output));
}
