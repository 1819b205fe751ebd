//! `cargo bench -p flockslam --bench recordings`: how fast an MCAP file of 1 GB is read, with how much memory, and what reading and ingest
//! cost when a recording is read at its own pace. The files lie below the target folder and are removed.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_lidar_ingest::Settings;
use flockslam_lidar_ingest::process::RecordingReader;
use flockslam_messages::ScanBuffer;
use flockslam_simulation::{Settings as Drive, Simulation, World};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::Command;
use std::time::Instant;
use support::ros_recording::{RosRecording, in_space};
use support::run_well;

/// Bytes of the large files.
const LARGE: u64 = 1_000_000_000;
/// Each is read so often; the median counts.
const TIMES: usize = 5;
/// A message of another topic: a small picture.
const PICTURE: usize = 200_000;
const SECONDS: u64 = 60;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if let [read, path] = arguments.as_slice() {
        return read_once(read, Path::new(path));
    }
    let directory = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a directory");
    for (name, pictures) in [("scans of 500 beams and odometry", 0), ("the same with a camera", 2)] {
        let path = directory.path().join("large.mcap");
        write_large(&path, pictures);
        report_large(name, &path);
        std::fs::remove_file(&path).expect("the file can be removed");
    }
    own_pace(directory.path());
}

/// A simulated drive, again and again, with `pictures` for each scan.
fn write_large(path: &Path, pictures: usize) {
    let mut recording = RosRecording::create_unpacked(path);
    let scans = drive();
    let picture = vec![7; PICTURE];
    recording.static_transform("base_link", "laser", &in_space(flockslam_geometry::Pose::IDENTITY));
    let (mut written, mut stamp_ns) = (0, 0);
    for scan in scans.iter().cycle() {
        let mut scan = scan.clone();
        stamp_ns += 100_000_000;
        scan.header.times.sensor_ns = stamp_ns;
        recording.scan("/scan", "laser", &scan);
        recording.odometry(stamp_ns, scan.header.odometry);
        for _ in 0..pictures {
            recording.raw("/camera", "sensor_msgs/msg/Image", stamp_ns, &picture);
        }
        written += 4 * u64::from(scan.header.beam_count) + 900 + (pictures * PICTURE) as u64;
        if written > LARGE {
            break;
        }
    }
    recording.finish();
}

/// Scans of 500 beams, ten a second.
fn drive() -> Vec<ScanBuffer> {
    let settings = Drive { duration_s: SECONDS as f64, beams: 500, scan_rate_hz: 10.0, ..Drive::default() };
    let mut simulation = Simulation::new(&settings, World::floor_plan()).expect("a world");
    let (mut scan, mut scans) = (ScanBuffer::default(), Vec::new());
    while simulation.next_scan(&mut scan).is_some() {
        scans.push(scan.clone());
    }
    scans
}

fn report_large(name: &str, path: &Path) {
    let bytes = std::fs::metadata(path).expect("the file is there").len() as f64;
    let median = |how: &str, is_on_disk: bool| {
        let run = || {
            prepare(path, is_on_disk);
            child(how, path)
        };
        let mut runs: Vec<(f64, u64)> = (0..TIMES).map(|_| run()).collect();
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        runs[TIMES / 2]
    };
    for (where_it_is, is_on_disk) in [("on disk", true), ("in memory", false)] {
        let (plain_s, plain_rss) = median("bytes", is_on_disk);
        let (scans_s, scans_rss) = median("scans", is_on_disk);
        println!(
            "{name}, {:.2} GB {where_it_is}: bytes alone {:.2} GB/s, {:.1} MB of memory; scans {:.2} GB/s, {:.1} MB: {:.0} % of the speed",
            bytes * 1e-9,
            bytes * 1e-9 / plain_s,
            plain_rss as f64 * 1e-3,
            bytes * 1e-9 / scans_s,
            scans_rss as f64 * 1e-3,
            100.0 * plain_s / scans_s
        );
    }
}

/// Takes a file out of the cache of the system, or into it.
fn prepare(path: &Path, is_on_disk: bool) {
    let mut file = File::open(path).expect("a file");
    if is_on_disk {
        file.sync_all().expect("the file is written");
        rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed).expect("the system drops it");
    } else {
        std::io::copy(&mut file, &mut std::io::sink()).expect("bytes");
    }
}

/// Reads in a process of its own: seconds, and its peak of memory, kB.
fn child(how: &str, path: &Path) -> (f64, u64) {
    let myself = std::env::current_exe().expect("a benchmark has a file");
    let output = Command::new(myself).arg(how).arg(path).output().expect("it can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    let mut words = text.split_whitespace();
    let mut word = || words.next().expect("two numbers");
    (word().parse().expect("seconds"), word().parse().expect("kB"))
}

fn read_once(how: &str, path: &Path) {
    let started = Instant::now();
    if how == "bytes" {
        let (mut file, mut buffer) = (File::open(path).expect("a file"), vec![0; 1 << 20]);
        while file.read(&mut buffer).expect("bytes") > 0 {}
    } else {
        let mut reader = RecordingReader::open(path, &Settings::default()).expect("a recording");
        let mut scan = ScanBuffer::default();
        while reader.next_scan(&mut scan).expect("scans") {}
    }
    let seconds = started.elapsed().as_secs_f64();
    let status = std::fs::read_to_string("/proc/self/status").expect("the kernel says it");
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a peak");
    println!("{seconds} {}", peak.trim().trim_end_matches(" kB"));
}

/// Processor time of reading and ingest for each second of a recording that is read at its own pace.
fn own_pace(directory: &Path) {
    let path = directory.join("drive.mcap");
    let mut recording = RosRecording::create(&path);
    recording.static_transform("base_link", "laser", &in_space(flockslam_geometry::Pose::IDENTITY));
    for scan in drive() {
        recording.odometry(scan.header.times.sensor_ns, scan.header.odometry);
        recording.scan("/scan", "laser", &scan);
    }
    recording.finish();
    let args =
        ["map", path.to_str().expect("a name"), "--rate", "1", "--live", "--set", "page.enabled=false"];
    let report = run_well("own-pace", &directory.join("out"), &args.map(str::to_owned)).report;
    let per_second = |cpu_s: f64| 1e3 * cpu_s / SECONDS as f64;
    let ingest = &report.stages["lidar-ingest"];
    println!(
        "at its own pace, 10 Hz and 500 beams: lidar-ingest {:.1} ms of processor time a second, the whole set {:.1} ms; {} scans",
        per_second(ingest.cpu_s),
        per_second(report.cpu_s),
        report.scans
    );
}
