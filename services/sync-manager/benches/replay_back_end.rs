//! Replays a log and a front end's poses through the back end, and prints what each part costs.
//!
//! `cargo bench -p flockslam-sync-manager --bench replay_back_end -- LOG POSES OUT.tum [all]`, where LOG is a CARMEN log with FLASER lines and each
//! line of POSES is `stamp x y heading odometry_x odometry_y odometry_heading inserted`. With `all`, scans
//! that were not inserted are given to the back end too. `SETTINGS` in the environment may hold settings as
//! JSON.

#![allow(clippy::disallowed_methods, reason = "no result depends on it")]

use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer, ScanId, SubmapClosed};
use flockslam_sync_manager::{Settings, SyncManager};
use std::error::Error;
use std::io::Write;
use std::time::{Duration, Instant};

/// Travel after which the pretended mapper closes a submap, metres.
const SUBMAP_M: f64 = 8.0;

fn scans(log: &str) -> Result<Vec<ScanBuffer>, Box<dyn Error>> {
    let mut scans = Vec::new();
    for line in log.lines().filter(|line| line.starts_with("FLASER ")) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let beams: usize = words[1].parse()?;
        let ranges: Result<Vec<f32>, _> = words[2..2 + beams].iter().map(|w| w.parse()).collect();
        let tail: Result<Vec<f64>, _> = words[2 + beams..8 + beams].iter().map(|w| w.parse()).collect();
        let tail = tail?;
        let step = 180.0 / if beams % 2 == 1 { beams - 1 } else { beams } as f64;
        let mut scan = ScanBuffer::from_ranges(&ranges?, (-90f64).to_radians(), step.to_radians());
        scan.header.range_max_m = 49.9;
        let (laser, robot) = (Pose::new(tail[0], tail[1], tail[2]), Pose::new(tail[3], tail[4], tail[5]));
        scan.header.base_from_laser = robot.to(laser);
        scans.push(scan);
    }
    Ok(scans)
}

fn poses(text: &str) -> Result<Vec<PoseEstimate>, Box<dyn Error>> {
    let mut poses = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let v: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let mut pose = PoseEstimate {
            id: ScanId { sequence: i as u64, ..ScanId::default() },
            ..PoseEstimate::default()
        };
        pose.times.sensor_ns = (v[0] * 1e9).round() as i64;
        pose.odom_from_base = Pose::new(v[1], v[2], v[3]);
        pose.odometry = Pose::new(v[4], v[5], v[6]);
        pose.flags =
            PoseFlags::MATCHED | PoseFlags::HAS_ODOMETRY | if v[7] > 0.5 { PoseFlags::INSERT } else { 0 };
        poses.push(pose);
    }
    Ok(poses)
}

fn main() -> Result<(), Box<dyn Error>> {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().filter(|argument| argument != "--bench").collect();
    let settings: Settings = match std::env::var("SETTINGS") {
        Ok(text) => serde_json::from_str(&text)?,
        Err(_) => Settings::default(),
    };
    let scans = scans(&std::fs::read_to_string(&arguments[1])?)?;
    let poses = poses(&std::fs::read_to_string(&arguments[2])?)?;
    let all = arguments.get(4).is_some_and(|word| word == "all");
    let mut manager = SyncManager::new(settings);
    let (mut trajectory, mut closing, mut slowest) = (Duration::ZERO, Duration::ZERO, Duration::ZERO);
    let (mut submap, mut travel_m, mut inserted) = (0u32, 0.0, 0u32);
    let mut last = poses[0].odom_from_base;
    for (scan, pose) in scans.iter().zip(&poses) {
        let mut pose = *pose;
        pose.submap = submap;
        let start = Instant::now();
        manager.pose(&pose);
        if all || pose.has(PoseFlags::INSERT) {
            manager.node(scan.view()?, &pose, &[]);
        }
        trajectory += start.elapsed();
        inserted += u32::from(pose.has(PoseFlags::INSERT));
        travel_m += last.distance_m(pose.odom_from_base);
        last = pose.odom_from_base;
        if travel_m >= SUBMAP_M {
            let notice = SubmapClosed { last: pose.id, number: submap, ..SubmapClosed::default() };
            let start = Instant::now();
            manager.submap_closed(&notice);
            closing += start.elapsed();
            slowest = slowest.max(start.elapsed());
            (submap, travel_m) = (submap + 1, 0.0);
        }
    }
    let start = Instant::now();
    let solution = manager.finish();
    let finish = start.elapsed();
    println!(
        "{} scans, {inserted} inserted, {submap} submaps; odometry {trajectory:.2?}, closing {closing:.2?} (slowest {slowest:.2?}), finish {finish:.2?}; {:?}",
        poses.len(),
        solution.closures
    );
    let mut out = std::io::BufWriter::new(std::fs::File::create(&arguments[3])?);
    for placed in &solution.trajectory {
        let Pose { x_m, y_m, heading_rad } = placed.map_from_base;
        let (sin, cos) = (0.5 * heading_rad).sin_cos();
        writeln!(out, "{:.6} {x_m} {y_m} 0 0 0 {sin} {cos}", placed.stamp_ns as f64 * 1e-9)?;
    }
    Ok(())
}
