//! `cargo bench -p flockslam --bench ros_latency`: a robot of the client library of ROS plays a drive into the graph. From a scan to its
//! transform and its pose as the robot receives them, the processor time and memory of the bridge; then ten times a span without hostile
//! traffic, one with it, and one in which as much is sent in another domain, from a scan to its pose on the bus: the robot has enough to do
//! with such traffic itself. What sends takes most of a processor, which a network does not: the third span shows what that does without
//! the traffic. `-- cost` and `-- hostile` run one of the two.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_bus::{Bus, Capacity, RuntimeDir};
use flockslam_messages::PoseEstimate;
use flockslam_telemetry::monotonic_ns;
use serde_json::Value;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use support::ros_peers::{Graph, udp_ports};
use support::{LiveSet, processes_of, simulated_drive, wait_for};

/// The drive of the first measurement, seconds.
const DRIVE_S: f64 = 120.0;
/// A span of the second one, seconds; how often there are three of them: the whole must end within the four minutes that a test waits.
/// Scans come four times as fast.
const SPAN_S: u32 = 7;
const PAIRS: u32 = 10;
const FASTER: f64 = 4.0;
/// What begins and ends is left out, nanoseconds.
const EDGE_NS: i64 = 1_000_000_000;
/// map → odom is stamped so much ahead of its scan.
const AHEAD_NS: i64 = 200_000_000;
/// How long to sleep between looks for a pose.
const LOOK: Duration = Duration::from_micros(50);
/// Messages a second.
const FLOOD: u32 = 10_000;

fn bridge(set: &LiveSet) -> u32 {
    let is_bridge = |pid: &u32| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0).nth(1) == Some(b"ros")
    };
    wait_for("the bridge", || {
        processes_of(&set.runtime_dir().display().to_string()).into_iter().find(is_bridge)
    })
}

fn cpu_s(pid: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("the process is there");
    let fields: Vec<_> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    (fields[11].parse::<f64>().unwrap_or(0.0) + fields[12].parse::<f64>().unwrap_or(0.0)) / 100.0
}

/// Memory by its kind: of one process (`Anonymous`), and with its share of what it has together with others (`Pss`).
fn memory_mib(pid: u32, kind: &str) -> f64 {
    let rollup = std::fs::read_to_string(format!("/proc/{pid}/smaps_rollup")).expect("the process is there");
    let line = rollup.lines().find(|line| line.split(':').next() == Some(kind)).unwrap_or("");
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

/// Stamp, and when it was sent or received, of what the robot has noted.
fn times(noted: &Value, name: &str) -> Vec<(i64, i64)> {
    let rows = noted[name].as_array().expect("the robot notes rows");
    rows.iter().map(|row| (row[0].as_i64().unwrap_or(0), row[4].as_i64().unwrap_or(0))).collect()
}

/// When each scan was sent, and after how long, in milliseconds, it had its answer: that with its stamp or the next one.
fn delays(noted: &Value, answers: &str, ahead_ns: i64) -> Vec<(i64, f64)> {
    delays_to(noted, &times(noted, answers), ahead_ns)
}

fn delays_to(noted: &Value, received: &[(i64, i64)], ahead_ns: i64) -> Vec<(i64, f64)> {
    let delay = |(stamp_ns, sent_ns): (i64, i64)| {
        let (_, received_ns) = received.iter().find(|answer| answer.0 >= stamp_ns + ahead_ns)?;
        Some((sent_ns, (received_ns - sent_ns) as f64 * 1e-6))
    };
    times(noted, "sent").into_iter().filter_map(delay).collect()
}

/// Stamps of poses, and when they were on the bus, until it is over.
fn poses_on_bus(set_dir: &Path, is_over: &AtomicBool) -> Vec<(i64, i64)> {
    let runtime = RuntimeDir::open(set_dir).expect("the set runs");
    let bus = Bus::join(&runtime, "latency", Capacity::default()).expect("the set is joined");
    let subscriber = bus.subscriber::<PoseEstimate>().expect("poses can be received");
    let mut seen = Vec::new();
    while !is_over.load(Ordering::Relaxed) {
        match subscriber.receive().expect("poses are received") {
            Some(pose) => seen.push((pose.times.sensor_ns, monotonic_ns() as i64)),
            None => std::thread::sleep(LOOK),
        }
    }
    seen
}

fn quantile(delays_ms: &[f64], share: f64) -> f64 {
    let mut sorted = delays_ms.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share) as usize]
}

fn show(what: &str, noted: &Value, answers: &str, ahead_ns: i64) {
    let delays_ms: Vec<f64> =
        delays(noted, answers, ahead_ns).into_iter().map(|(_, delay_ms)| delay_ms).collect();
    let [p50, p99, most] = [0.5, 0.99, 1.0].map(|share| quantile(&delays_ms, share));
    println!("{what}: p50 {p50:.2} ms, p99 {p99:.2} ms, greatest {most:.2} ms of {} scans", delays_ms.len());
}

fn cost() {
    let Some(graph) = Graph::new() else { return };
    let directory = tempfile::tempdir().expect("a directory");
    let set = graph.set("cost", directory.path(), &[]);
    let pid = bridge(&set);
    let (log, _) = simulated_drive(directory.path(), DRIVE_S);
    let (before_s, since) = (cpu_s(pid), Instant::now());
    let noted = graph.play(&log, 1.0, "/");
    let share = (cpu_s(pid) - before_s) / since.elapsed().as_secs_f64();
    println!("scans sent, poses received: {}, {}", times(&noted, "sent").len(), times(&noted, "poses").len());
    show("scan to map → odom", &noted, "corrections", AHEAD_NS);
    show("scan to pose", &noted, "poses", 0);
    let [all, own, share_mib] = ["Rss", "Anonymous", "Pss"].map(|kind| memory_mib(pid, kind));
    println!(
        "bridge at 10 Hz: {:.2} % of a core, {own:.1} MiB of its own, {share_mib:.1} MiB with its share of what the processes of the set have \
         together, {all:.1} MiB with all of that",
        100.0 * share
    );
    set.command_well(&["down"]);
}

fn hostile() {
    let (Some(graph), Some(other)) = (Graph::new(), Graph::new()) else { return };
    let directory = tempfile::tempdir().expect("a directory");
    let set = graph.set("flood", directory.path(), &[]);
    let pid = bridge(&set);
    let spans_s = f64::from(3 * PAIRS * SPAN_S) + 4.0;
    let (log, _) = simulated_drive(directory.path(), spans_s * FASTER);
    let mut spans = Vec::new();
    let before_mib = memory_mib(pid, "Anonymous");
    let (is_over, set_dir) = (AtomicBool::new(false), set.runtime_dir());
    let (noted, received) = std::thread::scope(|scope| {
        let hearing = scope.spawn(|| poses_on_bus(&set_dir, &is_over));
        let playing = scope.spawn(|| graph.play(&log, FASTER, "/"));
        // Until the robot has begun.
        std::thread::sleep(Duration::from_secs(3));
        for _ in 0..PAIRS {
            let quiet_ns = monotonic_ns() as i64;
            std::thread::sleep(Duration::from_secs(SPAN_S.into()));
            let loud_ns = monotonic_ns() as i64;
            let before_mib = memory_mib(pid, "Anonymous");
            let _ = graph.hostile(SPAN_S, FLOOD, &udp_ports(pid)).wait();
            let more_mib = memory_mib(pid, "Anonymous") - before_mib;
            let other_ns = monotonic_ns() as i64;
            let _ = other.hostile(SPAN_S, FLOOD, &[]).wait();
            spans.push(([quiet_ns, loud_ns, other_ns, monotonic_ns() as i64], more_mib));
        }
        let noted = playing.join().expect("the robot plays");
        is_over.store(true, Ordering::Relaxed);
        (noted, hearing.join().expect("poses are received"))
    });
    assert_eq!(bridge(&set), pid, "it is the same process");
    println!("its own memory {before_mib:.0} MiB before, {:.0} MiB after", memory_mib(pid, "Anonymous"));
    println!("scans sent, poses: {}, {}", times(&noted, "sent").len(), received.len());
    let delays = delays_to(&noted, &received, 0);
    let of = |from_ns: i64, to_ns: i64| -> Vec<f64> {
        let within =
            delays.iter().filter(|(sent_ns, _)| (from_ns + EDGE_NS..to_ns - EDGE_NS).contains(sent_ns));
        within.map(|(_, delay_ms)| *delay_ms).collect()
    };
    let (mut to_quiet_ms, mut to_other_ms) = (Vec::new(), Vec::new());
    for (borders_ns, more_mib) in spans {
        let found = [0, 1, 2].map(|span| of(borders_ns[span], borders_ns[span + 1]));
        if found.iter().any(Vec::is_empty) {
            continue;
        }
        let [quiet_ms, loud_ms, other_ms] = found.each_ref().map(|delays_ms| quantile(delays_ms, 0.99));
        println!(
            "scan to pose, p99: quiet {quiet_ms:.2} ms, loud {loud_ms:.2} ms of {}, loud elsewhere {other_ms:.2} ms; {more_mib:+.1} MiB",
            found[1].len()
        );
        to_quiet_ms.push(loud_ms - quiet_ms);
        to_other_ms.push(loud_ms - other_ms);
    }
    println!(
        "median of the differences at p99 of {} pairs: {:+.2} ms to quiet spans, {:+.2} ms to those with as much traffic elsewhere",
        to_quiet_ms.len(),
        quantile(&to_quiet_ms, 0.5),
        quantile(&to_other_ms, 0.5)
    );
    set.command_well(&["down"]);
}

fn main() {
    let asked = |what: &str| std::env::args().any(|argument| argument == what);
    if !asked("hostile") {
        cost();
    }
    if !asked("cost") {
        hostile();
    }
}
