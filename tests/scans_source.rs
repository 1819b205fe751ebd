//! Sensors that speak by themselves: whatever carries what they say, the map is the same; and whatever befalls those who send, the set
//! goes on.

use crate::support::sensor_drive::{DrivenLidar, SensorDrive, stamp_ns};
use crate::support::tools::tool;
use crate::support::{Outputs, RunningSet, machine_share, not_tested, repository, run_well, send, wait_for};
use flockslam::evaluation::evaluate_truth;
use flockslam_geometry::Pose;
use flockslam_messages::Stage;
use flockslam_results::LidarStatus;
use flockslam_sensor_stream::{Producer, SensorFrame};
use flockslam_simulation::{Settings, WorldName};
use flockslam_stage::read_reports;
use flockslam_telemetry::{monotonic_ns, names};
use rustix::process::Signal;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Lines of CARMEN have the pose of the lidar in place of its mounting: what is taken from it differs by less than this, metres.
const CARMEN_DIFFERS_M: f64 = 2e-4;

fn settings(duration_s: f64, scan_rate_hz: f64) -> Settings {
    Settings { world: WorldName::Office, duration_s, scan_rate_hz, wheel_slips: 0, ..Settings::default() }
}

fn front() -> DrivenLidar {
    DrivenLidar { name: "front", place: Pose::new(0.2, 0.05, 0.3), every: 1 }
}

fn rear() -> DrivenLidar {
    DrivenLidar { name: "rear", place: Pose::new(-0.2, 0.0, 3.0), every: 1 }
}

/// An exact run on what a pipe has.
fn piped(place: &Path, bytes: &[u8]) -> Outputs {
    let args = ["map", "--source", "-"].map(str::to_owned);
    let mut set = RunningSet::start_with_pipe("piped", &place.join("piped"), &args);
    set.stdin.take().unwrap().write_all(bytes).unwrap();
    set.finish()
}

/// An exact run on what a producer sends to a socket.
fn sent(place: &Path, frames: &[SensorFrame]) -> Outputs {
    let socket = place.join("sensors");
    let args = ["map".to_owned(), "--source".to_owned(), format!("scans:{}", socket.display())];
    let set = RunningSet::start("sent", &place.join("sent"), &args);
    let mut producer = Producer::new(&socket, None);
    wait_for("the socket", || producer.connect().ok());
    frames.iter().for_each(|frame| producer.send(frame).unwrap());
    assert_eq!(producer.lost(), 0);
    drop(producer);
    set.finish()
}

fn same(one: &Outputs, other: &Outputs) -> bool {
    let files = ["trajectory.tum", "trajectory_online.tum", "map.pgm"];
    files.iter().all(|name| one.bytes(name) == other.bytes(name))
        && one.report.map_hash == other.report.map_hash
}

#[test]
fn a_recording_a_pipe_and_a_socket_give_the_same_map() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let drive = SensorDrive::new(&settings(20.0, 10.0), &[front()]);
    drive.record(&place.join("drive.mcap"));
    let args = ["map".to_owned(), place.join("drive.mcap").display().to_string()];
    let recorded = run_well("recorded", &place.join("recorded"), &args);
    assert_eq!(recorded.report.scans, 200);
    assert!(same(&recorded, &piped(place, &drive.bytes(SensorFrame::write_binary))), "binary frames");
    assert!(same(&recorded, &piped(place, &drive.bytes(SensorFrame::write_json))), "lines of JSON");
    assert!(same(&recorded, &sent(place, &drive.frames)), "a socket");
    // Lines of CARMEN have no times of beams.
    let at_once = drive.with_beams_at_once();
    let poses = piped(place, &at_once.bytes(SensorFrame::write_binary)).trajectory("trajectory.tum");
    let carmen = piped(place, &at_once.carmen(front().place)).trajectory("trajectory.tum");
    assert_eq!(poses.len(), carmen.len());
    let apart_m =
        poses.iter().zip(&carmen).map(|(one, other)| one.map_from_base.distance_m(other.map_from_base));
    let apart_m = apart_m.fold(0.0, f64::max);
    println!("lines of CARMEN: {apart_m:.6} m apart");
    assert!(apart_m < CARMEN_DIFFERS_M, "{apart_m} m");
}

#[test]
fn two_lidars_of_a_recording_and_of_a_socket_give_the_same_map() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let drive = SensorDrive::new(&settings(10.0, 10.0), &[front(), rear()]);
    drive.record(&place.join("drive.mcap"));
    let recording = place.join("drive.mcap").display().to_string();
    let args = ["map", &recording, "--scan", "/front", "--scan", "/rear"].map(str::to_owned);
    let recorded = run_well("recorded", &place.join("recorded"), &args);
    assert_eq!(recorded.report.scans, 200);
    assert!(same(&recorded, &sent(place, &drive.frames)));
}

#[test]
fn a_pipe_without_any_scan_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let drive = SensorDrive::new(&settings(1.0, 10.0), &[front()]);
    let mut bytes = Vec::new();
    let scans = drive.frames.iter().filter(|frame| !matches!(frame, SensorFrame::Scan(_)));
    scans.for_each(|frame| frame.write_json(&mut bytes));
    let args = ["map", "--source", "-"].map(str::to_owned);
    let mut set = RunningSet::start_with_pipe("scanless", directory.path(), &args);
    set.stdin.take().unwrap().write_all(&bytes).unwrap();
    assert_eq!(set.wait(), Some(2));
}

/// A live run that listens on its own socket, and that socket.
fn listening(test: &str, directory: &Path, more: &[&str]) -> (RunningSet, PathBuf) {
    let mut args = ["map", "--live", "--source", "scans", "--set", "page.enabled=false"].to_vec();
    args.extend(more);
    let args: Vec<String> = args.into_iter().map(str::to_owned).collect();
    let set = RunningSet::start(test, &directory.join("out"), &args);
    let socket = set.status_dir().with_file_name("scans");
    (set, socket)
}

/// Ends a live run in good order.
fn ended(set: RunningSet) -> Outputs {
    send(set.supervisor_pid(), Signal::INT);
    set.finish()
}

/// Sends frames at the pace of their stamps, so many times as fast, whether somebody listens or not; how many were lost.
fn send_paced(socket: &Path, frames: &[SensorFrame], rate: f64) -> u64 {
    let mut producer = Producer::new(socket, Some(Duration::from_millis(100)));
    wait_for("the socket", || producer.connect().ok());
    let since = Instant::now();
    // What always holds has no stamp.
    let first_ns = frames.iter().map(stamp_ns).find(|stamp_ns| *stamp_ns > 0).unwrap_or(0);
    for frame in frames {
        let due = Duration::from_nanos(((stamp_ns(frame) - first_ns).max(0) as f64 / rate) as u64);
        thread::sleep(due.saturating_sub(since.elapsed()));
        let _ = producer.send(frame);
    }
    producer.lost()
}

/// The sum over all processes of lidar-ingest so far.
fn counter(set: &RunningSet, name: &str) -> u64 {
    let reports = read_reports(&set.status_dir(), Stage::LidarIngest.name());
    reports.iter().filter_map(|report| report.counters.get(name)).sum()
}

fn wait_for_count(set: &RunningSet, name: &str) {
    wait_for(name, || (counter(set, name) > 0).then_some(()));
}

#[test]
fn producers_that_die_come_back_and_send_garbage_cost_no_more_than_their_frames() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = SensorDrive::new(&settings(12.0, 20.0), &[front()]);
    let (mut set, socket) = listening("producers", directory.path(), &[]);
    let (first, second) = drive.frames.split_at(drive.frames.len() / 2);
    let lost = thread::scope(|scope| {
        let sender = scope.spawn(|| send_paced(&socket, first, 2.0));
        set.wait_until_handled(Stage::ScanMatcher, 20);
        // One sends what is no frame, one dies in the middle of a frame.
        UnixStream::connect(&socket).unwrap().write_all(b"hello\n\xfa\xfa{}\n[1, 2]\n").unwrap();
        let mut frame = Vec::new();
        second[1].write_binary(&mut frame);
        UnixStream::connect(&socket).unwrap().write_all(&frame[..frame.len() / 2]).unwrap();
        sender.join().unwrap()
    });
    assert_eq!(lost, 0);
    // The next producer says again where its lidar sits, and outlives the process that listens to it.
    let again = [&drive.frames[..1], second].concat();
    let lost = thread::scope(|scope| {
        let sender = scope.spawn(|| send_paced(&socket, &again, 2.0));
        let matched = set.handled(Stage::ScanMatcher).unwrap_or(0);
        set.wait_until_handled(Stage::ScanMatcher, matched + 20);
        wait_for_count(&set, "rejected/bad_frame");
        wait_for_count(&set, "frames_broken_off");
        set.signal(Stage::LidarIngest, Signal::KILL);
        sender.join().unwrap()
    });
    println!("{lost} of {} frames lost to the restart", again.len());
    let outputs = ended(set);
    println!("rejected {:?}", outputs.report.rejected);
    for (stage, report) in &outputs.report.stages {
        assert_eq!(report.restarts, u64::from(stage == Stage::LidarIngest.name()), "{stage}");
    }
    let poses = outputs.trajectory("trajectory.tum");
    let error = evaluate_truth(&poses, &drive.truth).unwrap().absolute.translation_m.unwrap();
    println!("{} poses of {}, {:.3} m", poses.len(), drive.truth.len(), error.mean);
    assert!(poses.len() + lost as usize + 10 >= drive.truth.len() && error.mean < 0.05);
    assert!(outputs.report.rejected["bad_frame"] >= 1);
}

/// Frames of one producer: those of one lidar, with all that is no scan where it is the first.
fn frames_of(
    drive: &SensorDrive,
    lidar: &str,
    with_rest: bool,
    sends_at_s: impl Fn(f64) -> bool,
) -> Vec<SensorFrame> {
    let is_of = |frame: &&SensorFrame| match frame {
        SensorFrame::Scan(scan) => scan.lidar == lidar && sends_at_s(stamp_ns(frame) as f64 * 1e-9),
        _ => with_rest,
    };
    drive.frames.iter().filter(is_of).cloned().collect()
}

#[test]
fn a_lidar_that_stops_is_detected_and_used_again_after_its_return() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = SensorDrive::new(&settings(20.0, 10.0), &[front(), rear()]);
    let (mut set, socket) = listening("two", directory.path(), &[]);
    let front = frames_of(&drive, "front", true, |_| true);
    let rear = frames_of(&drive, "rear", false, |at_s| !(5.0..15.0).contains(&at_s));
    let status_dir = set.status_dir();
    let lidars = || LidarStatus::read(&status_dir);
    thread::scope(|scope| {
        let senders = [&front, &rear].map(|frames| scope.spawn(|| send_paced(&socket, frames, 2.0)));
        let scans_of =
            |name: &str| lidars().iter().find(|lidar| lidar.lidar == name).map_or(0, |lidar| lidar.scans);
        wait_for("the silence of one lidar, while the other goes on", || {
            let rear_is_silent =
                lidars().iter().any(|lidar| lidar.lidar == "rear" && lidar.is_silent(monotonic_ns()));
            (rear_is_silent && scans_of("front") > 110).then_some(())
        });
        let before = scans_of("rear");
        wait_for("its return", || (scans_of("rear") > before + 20).then_some(()));
        for sender in senders {
            assert_eq!(sender.join().unwrap(), 0);
        }
    });
    let page = wait_for("metrics", || set.metrics(Stage::LidarIngest));
    for lidar in ["front", "rear"] {
        let series = format!("{}{{lidar=\"{lidar}\",", names::LIDAR_SCANS.name);
        assert!(page.lines().any(|line| line.starts_with(&series)), "{series}");
    }
    set.wait_until_handled(Stage::SyncManager, 250);
    let outputs = ended(set);
    let stamps: Vec<i64> =
        outputs.trajectory("trajectory_online.tum").iter().map(|point| point.stamp_ns).collect();
    let reversed = stamps.windows(2).filter(|pair| pair[1] < pair[0]).count();
    let poses = outputs.trajectory("trajectory.tum");
    let error = evaluate_truth(&poses, &drive.truth).unwrap().absolute.translation_m.unwrap();
    println!("{} poses, {reversed} out of order, {:.3} m", poses.len(), error.mean);
    // What is delayed by more than 50 ms on a busy machine comes out of order.
    assert!(poses.len() >= 290 && reversed <= 15 && error.mean < 0.05);
}

/// The driver in JSON of docs/drivers.md.
fn documented_driver() -> String {
    let text = std::fs::read_to_string(repository().join("docs/drivers.md")).unwrap();
    let blocks = text.split("```python\n").skip(1).filter_map(|block| block.split("```").next());
    blocks.into_iter().find(|block| block.contains("json.dumps")).expect("a driver in JSON").to_owned()
}

#[test]
fn the_documented_driver_in_python_drives_a_set() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    if tool(directory.path(), Path::new("python3"), &["--version"]).is_none() {
        not_tested("the documented driver", "there is no python3");
        return;
    }
    std::fs::write(directory.path().join("driver.py"), documented_driver()).unwrap();
    let (mut set, socket) = listening("documented", directory.path(), &[]);
    wait_for("the socket", || socket.exists().then_some(()));
    let mut driver = Command::new("python3");
    driver.arg(directory.path().join("driver.py")).arg(&socket).stdout(Stdio::null());
    let mut driver = driver.spawn().unwrap();
    set.wait_until_handled(Stage::ScanMatcher, 5);
    driver.kill().unwrap();
    driver.wait().unwrap();
    let outputs = ended(set);
    assert!(outputs.report.scans >= 5 && outputs.report.rejected.values().all(|count| *count == 0));
}
