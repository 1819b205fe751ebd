//! `cargo bench -p flockslam --bench flock_latency`: what other robots cost this one's poses. A robot that drives alone, under a flood of
//! hostile messages, beside a robot of another flock, with one of its own and with one of its own that drives no more takes turns; a number
//! behind `--` sets how many of each (5), names which of them. p99 of a single run says little: medians are compared.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use serde_json::Value;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use support::flocks::{FlockRobot, flood};
use support::{Drive, free_port};

const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 40.0, rate: 1.0 };
/// Hostile messages a second.
const FLOOD: u32 = 10_000;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Neighbours {
    Nobody,
    /// Hostile messages.
    Flood,
    /// A robot of another flock, which takes its share of the machine.
    Unmerged,
    /// A robot of its own flock, on the same machine.
    Member,
    /// A robot of its own flock that has driven before, knows all of the building and only talks: what synchronising alone costs.
    Converged,
}

const ALL: [Neighbours; 5] =
    [Neighbours::Nobody, Neighbours::Flood, Neighbours::Unmerged, Neighbours::Member, Neighbours::Converged];

/// Microseconds from a scan's arrival to its pose, and memory of sync-manager.
struct Run {
    p50_us: f64,
    p99_us: f64,
    peak_mb: f64,
    hostile: usize,
}

fn run(neighbours: Neighbours) -> Run {
    let directory = tempfile::tempdir().expect("a directory");
    let mut robots = match neighbours {
        Neighbours::Converged => beside_a_converged_one(directory.path()),
        Neighbours::Member => FlockRobot::start_all("latency", directory.path(), DRIVE, 2),
        _ => FlockRobot::start_all("latency", directory.path(), DRIVE, 1),
    };
    if neighbours == Neighbours::Unmerged {
        robots.extend(FlockRobot::start_all("unmerged", &directory.path().join("unmerged"), DRIVE, 1));
    }
    let (over, mut hostile) = (AtomicBool::new(false), 0);
    if neighbours == Neighbours::Flood {
        robots[0].wait_for_flock("a record", |flock| flock.records.0 > 0);
        hostile = std::thread::scope(|scope| {
            let sender = scope.spawn(|| flood(&robots[0], FLOOD, &over));
            std::thread::sleep(std::time::Duration::from_secs_f64(DRIVE.duration_s - 15.0));
            over.store(true, Ordering::Relaxed);
            sender.join().expect("the flood ends")
        });
    }
    let own = directory.path().join("robot-0");
    robots.into_iter().for_each(|robot| drop(robot.finish()));
    let report: Value =
        serde_json::from_slice(&std::fs::read(own.join("out/report.json")).expect("a report")).expect("JSON");
    let number = |path: &str| report.pointer(path).and_then(Value::as_f64).expect("a figure of the report");
    Run {
        p50_us: number("/scan_to_pose_us/p50"),
        p99_us: number("/scan_to_pose_us/p99"),
        peak_mb: number("/stages/sync-manager/peak_rss_bytes") * 1e-6,
        hostile,
    }
}

/// The robot that is measured, and one that has driven before.
fn beside_a_converged_one(directory: &Path) -> Vec<FlockRobot> {
    let endpoints = [(); 2].map(|()| format!("tcp/127.0.0.1:{}", free_port()));
    let stays = ("office", "wait_for_robots = 1\nwait_max_s = 90.0");
    let before = Drive { duration_s: 200.0, rate: 20.0, ..DRIVE };
    let mut converged = FlockRobot::start_one("latency", directory, before, &endpoints, 1, stays);
    converged.wait_for_flock("the end of its drive", |flock| flock.has_ended && flock.converged);
    vec![FlockRobot::start_one("latency", directory, DRIVE, &endpoints, 0, ("office", "")), converged]
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let runs = std::env::args().filter_map(|argument| argument.parse().ok()).next().unwrap_or(5);
    let named =
        |kind: &Neighbours| std::env::args().any(|argument| argument == format!("{kind:?}").to_lowercase());
    let some = ALL.iter().any(named);
    let kinds: Vec<Neighbours> = ALL.into_iter().filter(|kind| !some || named(kind)).collect();
    let mut all: Vec<Vec<Run>> = kinds.iter().map(|_| Vec::new()).collect();
    for _ in 0..runs {
        for (kind, all) in kinds.iter().zip(&mut all) {
            all.push(run(*kind));
        }
    }
    println!(
        "| neighbours | runs | p50 µs | p99 µs, median of runs | least … most | sync-manager at most MB | hostile messages |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (kind, all) in kinds.iter().zip(&all) {
        let of = |pick: fn(&Run) -> f64| all.iter().map(pick).collect::<Vec<_>>();
        let p99 = of(|run| run.p99_us);
        let (least, most) =
            (p99.iter().copied().fold(f64::MAX, f64::min), p99.iter().copied().fold(0.0, f64::max));
        println!(
            "| {kind:?} | {} | {:.0} | {:.0} | {least:.0} … {most:.0} | {:.0} | {} |",
            all.len(),
            median(of(|run| run.p50_us)),
            median(p99.clone()),
            of(|run| run.peak_mb).into_iter().fold(0.0, f64::max),
            all.iter().map(|run| run.hostile).max().unwrap_or(0)
        );
    }
}
