//! `cargo bench -p flockslam --bench lidar_latency`: each family of lidars at a pseudo terminal or a TCP port. From the byte with which a
//! turn is whole to its pose, and the processor time of lidar-ingest. `-- two` plays two lidars of different families for 10 minutes, of
//! which one is unplugged and back every 30 s.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_bus::{Bus, Capacity, RuntimeDir};
use flockslam_lidars::encoders::rplidar_encoder::RplidarEncoder;
use flockslam_lidars::encoders::sick_tim_encoder::SickTimEncoder;
use flockslam_lidars::encoders::urg_encoder::UrgEncoder;
use flockslam_lidars::encoders::ydlidar_encoder::YdlidarEncoder;
use flockslam_messages::{PoseEstimate, Stage};
use flockslam_telemetry::monotonic_ns;
use std::path::Path;
use std::time::{Duration, Instant};
use support::lidar_player::{LidarPlayer, Played};
use support::{LiveSet, robot};

/// Each latency is measured for so long.
const MEASURED: Duration = Duration::from_secs(60);
/// Two lidars are played for so long, and one goes so often.
const TOGETHER: Duration = Duration::from_secs(600);
const EVERY: Duration = Duration::from_secs(30);
/// How long to sleep between looks for a pose.
const LOOK: Duration = Duration::from_micros(50);

fn set_of(test: &str, directory: &Path, source: &str) -> LiveSet {
    let robot = robot(test);
    let text = format!("robot = \"{robot}\"\nset = [\"page.enabled=false\"]\n[source]\n{source}\n");
    std::fs::write(directory.join("set.toml"), text).expect("the description is written");
    LiveSet::start_again(robot, directory, &[])
}

fn cpu_ticks(pid: u32) -> u64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("the process is there");
    let fields: Vec<_> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    fields[11].parse::<u64>().unwrap_or(0) + fields[12].parse::<u64>().unwrap_or(0)
}

/// Poses as they are published, with their times on the monotonic clock.
fn poses(set: &LiveSet, during: Duration) -> Vec<(PoseEstimate, u64)> {
    let runtime = RuntimeDir::open(&set.runtime_dir()).expect("the set runs");
    let bus = Bus::join(&runtime, "latency", Capacity::default()).expect("the set is joined");
    let subscriber = bus.subscriber::<PoseEstimate>().expect("poses can be received");
    let (mut seen, since) = (Vec::new(), Instant::now());
    while since.elapsed() < during {
        match subscriber.receive().expect("poses are received") {
            Some(pose) => seen.push((*pose, monotonic_ns())),
            None => std::thread::sleep(LOOK),
        }
    }
    seen
}

/// A family: its name in descriptions, the lidar that is played, and whether it is on the network.
fn lidar(kind: &str) -> (Played, bool) {
    match kind {
        "ld06" => (Played::ld06(), false),
        "rplidar" => (Played::Rplidar(RplidarEncoder::new(0x85, 10.0)), false),
        "ydlidar" => (Played::Ydlidar(YdlidarEncoder::new("T-mini Plus", 3, 8.0)), false),
        "urg" => (Played::Urg(UrgEncoder::new()), true),
        _ => (Played::SickTim(SickTimEncoder::new()), true),
    }
}

fn latency(kind: &str) {
    let directory = tempfile::tempdir().expect("a directory");
    let (player, place) = match lidar(kind) {
        (lidar, true) => {
            let (player, address) = LidarPlayer::listen(lidar);
            (player, format!("address = {address:?}"))
        }
        (lidar, false) => {
            let path = directory.path().join("lidar");
            (LidarPlayer::plug(&path, lidar), format!("port = {path:?}"))
        }
    };
    let mut set = set_of("line", directory.path(), &format!("kind = \"{kind}\"\n{place}"));
    set.wait_until_handled(Stage::ScanMatcher, 50);
    let pid = set.pid(Stage::LidarIngest);
    let (before, since) = (cpu_ticks(pid), Instant::now());
    let seen = poses(&set, MEASURED);
    let cpu_ms_per_s = (cpu_ticks(pid) - before) as f64 * 10.0 / since.elapsed().as_secs_f64();
    let turns_ns = player.turns_ns();
    let mut latencies_ms: Vec<f64> = seen
        .iter()
        .filter_map(|(_, at_ns)| {
            let sent = turns_ns.partition_point(|turn_ns| turn_ns < at_ns).checked_sub(1)?;
            Some((at_ns - turns_ns[sent]) as f64 * 1e-6)
        })
        .collect();
    latencies_ms.sort_by(f64::total_cmp);
    let quantile = |share: f64| latencies_ms[((latencies_ms.len() - 1) as f64 * share) as usize];
    let (beams, speed_hz) =
        set.status().map_or((0, 0.0), |status| (status.lidar_lines[0].beams, status.lidar_lines[0].speed_hz));
    println!(
        "{kind}, {beams} beams, {speed_hz:.1} Hz: {} poses, p50 {:.2} ms, p99 {:.2} ms, greatest {:.2} ms; lidar-ingest {cpu_ms_per_s:.1} ms of CPU a second",
        latencies_ms.len(),
        quantile(0.5),
        quantile(0.99),
        quantile(1.0)
    );
}

fn two_lidars() {
    let directory = tempfile::tempdir().expect("a directory");
    let paths = ["front", "rear"].map(|name| directory.path().join(name));
    let _front = LidarPlayer::plug(&paths[0], Played::ld06());
    let rear = || Played::Rplidar(RplidarEncoder::new(0x85, 10.0));
    let mut player = Some(LidarPlayer::plug(&paths[1], rear()));
    let source = format!(
        "kind = \"lidars\"\nlidars = [{{ name = \"front\", kind = \"ld06\", port = {:?} }}, \
         {{ name = \"rear\", kind = \"rplidar\", port = {:?} }}]",
        paths[0], paths[1]
    );
    let mut set = set_of("together", directory.path(), &source);
    set.wait_until_handled(Stage::ScanMatcher, 20);
    let (mut all, since) = (Vec::new(), Instant::now());
    while since.elapsed() < TOGETHER {
        all.extend(poses(&set, EVERY));
        player = match player {
            Some(player) => {
                drop(player);
                None
            }
            None => Some(LidarPlayer::plug(&paths[1], rear())),
        };
    }
    let missing: u64 =
        all.windows(2).map(|pair| pair[1].0.id.sequence.saturating_sub(pair[0].0.id.sequence + 1)).sum();
    let by = |lidar: u32| all.iter().filter(|(pose, _)| pose.id.lidar == lidar).count();
    let farthest_m = all
        .iter()
        .map(|(pose, _)| pose.odom_from_base.x_m.hypot(pose.odom_from_base.y_m))
        .fold(0.0, f64::max);
    let returns = set.status().map_or(0, |status| status.lidar_lines[1].returns);
    println!(
        "two lidars, {:.0} s: {} and {} poses, {missing} scans without (between looks poses may be missed), back {returns} times, at most {farthest_m:.3} m from where the robot stands",
        since.elapsed().as_secs_f64(),
        by(0),
        by(1)
    );
}

fn main() {
    let asked = |name: &str| std::env::args().any(|argument| argument == name);
    if asked("two") {
        return two_lidars();
    }
    let kinds = ["ld06", "rplidar", "ydlidar", "urg", "sick-tim"];
    if let Some(kind) = kinds.into_iter().find(|kind| asked(kind)) {
        return latency(kind);
    }
    // A process is a member of one set in its life.
    let program = std::env::current_exe().expect("this program has a path");
    for kind in kinds {
        let measured = std::process::Command::new(&program).arg(kind).status();
        assert!(measured.is_ok_and(|status| status.success()), "{kind}");
    }
}
