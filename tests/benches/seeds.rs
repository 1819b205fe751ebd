//! How outcomes that depend on a seed are spread: `cargo bench -p flockslam --bench seeds -- [yard|campus|people|flat|cuts] [SEEDS]`, twenty seeds
//! of each by default, or the seeds FIRST..LAST; cuts: the robot is kidnapped at eight places of each public log.
//! Tests check a few of these drives; their limits come from here.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_drives::experiments::BEARING_SIGMA_RAD;
use flockslam_messages::PoseEstimate;
use std::ops::RangeInclusive;
use support::kidnapped_log::{cut_at, kidnapped};
use support::public_logs::{FILTER_OFF, LOGS, Log};
use support::seeded_drives::{YardDrive, alone_and_among_twenty_m, campus_drive, flat_worst, run_watched};

fn main() {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let seeds = arguments.iter().find_map(|argument| seeds_of(argument)).unwrap_or(1..=20);
    let wants = |name: &str| {
        arguments.iter().all(|argument| seeds_of(argument).is_some()) || arguments.iter().any(|a| a == name)
    };
    if wants("flat") {
        for (name, sigma_rad) in [("exact bearings", 0.0), ("bearings off by a degree", BEARING_SIGMA_RAD)] {
            let worst: Vec<_> = seeds.clone().map(|seed| flat_worst(sigma_rad, seed)).collect();
            spread(&format!("flat, {name}: way, mm"), worst.iter().map(|worst| 1e3 * worst.way_m));
            spread(&format!("flat, {name}: turn, degrees"), worst.iter().map(|worst| worst.turn_deg));
            spread(&format!("flat, {name}: end, mm"), worst.iter().map(|worst| 1e3 * worst.end_m));
        }
    }
    if wants("yard") {
        let drives: Vec<_> = seeds.clone().map(YardDrive::with_seed).collect();
        drives.iter().zip(seeds.clone()).for_each(|(drive, seed)| println!("yard, seed {seed}: {drive:?}"));
        let claims: usize = drives.iter().map(|drive| drive.claims).sum();
        let wrong: usize = drives.iter().map(|drive| drive.false_claims).sum();
        println!("yard: {wrong} of {claims} seconds wrong though said to be tracked");
        spread(
            "yard: false claims of a thousand",
            drives.iter().map(|d| 1e3 * d.false_claims as f64 / d.claims as f64),
        );
        spread("yard: ATE, m", drives.iter().map(|drive| drive.ate_m));
    }
    if wants("campus") {
        let drives: Vec<_> = seeds.clone().map(campus_drive).collect();
        spread("campus: ATE, m", drives.iter().map(|(ate_m, _)| *ate_m));
        spread("campus: scans that are not in the map", drives.iter().map(|(_, detached)| *detached as f64));
    }
    if wants("cuts") {
        LOGS.iter().for_each(print_cuts);
    }
    if wants("people") {
        for building in [None, Some("stata_basement")] {
            let name = building.unwrap_or("office");
            let drives = seeds.clone().map_while(|seed| alone_and_among_twenty_m(building, seed));
            let drives: Vec<_> = drives.collect();
            spread(&format!("{name}: ATE alone, mm"), drives.iter().map(|[alone, _]| 1e3 * alone));
            spread(&format!("{name}: ATE among twenty, mm"), drives.iter().map(|[_, among]| 1e3 * among));
            spread(
                &format!("{name}: difference, mm"),
                drives.iter().map(|[alone, among]| 1e3 * (among - alone)),
            );
        }
    }
}

/// The seeds that an argument names: so many from 1 on, or FIRST..LAST.
fn seeds_of(argument: &str) -> Option<RangeInclusive<u64>> {
    let (first, last) = argument.split_once("..").unwrap_or(("1", argument));
    Some(first.parse().ok()?..=last.parse().ok()?)
}

/// Prints the results for a robot that is kidnapped on its way, without a trace in its odometry.
fn print_cuts(log: &Log) {
    let Some(file) = log.file("clf") else { return };
    let text = String::from_utf8_lossy(&std::fs::read(&file).unwrap()).into_owned();
    let scans = text.lines().filter(|line| line.starts_with("FLASER ")).count();
    for k in 1..=8 {
        let directory = tempfile::tempdir().unwrap();
        let (cut_log, cut) = (directory.path().join("cut.clf"), cut_at(k, scans));
        std::fs::write(&cut_log, kidnapped(&file, cut)).unwrap();
        let args = ["map", &cut_log.display().to_string(), "--set", FILTER_OFF].map(str::to_owned);
        let (outputs, poses) = run_watched("cut", &directory.path().join("out"), &args);
        let noticed = noticed_after_m(&poses[cut.0 - 1..])
            .map_or("not noticed".to_owned(), |way_m| format!("noticed after {way_m:.1} m"));
        let errors = log.errors_of_a_part(&outputs);
        println!(
            "{}, carried at scan {}: {noticed}, {} trajectories, {} scans unattached, error mean {:.4} m, greatest {:.2} m",
            log.name,
            cut.0,
            outputs.report.trajectories,
            outputs.report.detached_scans,
            errors.mean_m,
            errors.max_m
        );
    }
}

/// The way by odometry, metres, until another trajectory begins than that of the first pose.
fn noticed_after_m(poses: &[PoseEstimate]) -> Option<f64> {
    let mut way_m = 0.0;
    for step in poses.windows(2) {
        if step[1].trajectory != poses[0].trajectory {
            return Some(way_m);
        }
        way_m += step[0].odometry.distance_m(step[1].odometry);
    }
    None
}

/// Prints the mean, the median, the greatest, and all in order.
fn spread(name: &str, values: impl Iterator<Item = f64>) {
    let all: Vec<f64> = values.collect();
    let mut sorted = all.clone();
    sorted.sort_by(f64::total_cmp);
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    let shown: Vec<String> = all.iter().map(|value| format!("{value:.2}")).collect();
    println!(
        "{name}: mean {mean:.2}, median {:.2}, greatest {:.2}; by seed {}",
        sorted[all.len() / 2],
        sorted[all.len() - 1],
        shown.join(" ")
    );
}
