//! Prints which share of the benchmark logs the filter drops with its default settings, and what a verdict costs.
//!
//! `cargo run --release -p flockslam-correlation-filter --example drop_share`; the logs are looked for in the folder
//! named by FLOCKSLAM_DATA, else in `../shared/data`. Settings may be given as one JSON argument.

use flockslam_correlation_filter::process::tally_part;
use flockslam_correlation_filter::{CorrelationFilter, Settings};
use flockslam_geometry::Pose;
use flockslam_messages::{DropReason, KeepReason, ScanBuffer};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Name of a log, degrees between its beams, and the range that means no return.
const LOGS: [(&str, f64, f32); 3] = [("intel", 1.0, 49.5), ("fr079", 0.5, 49.5), ("aces", 1.0, 49.5)];

fn main() {
    let settings = match std::env::args().nth(1) {
        Some(json) => serde_json::from_str(&json).expect("settings as JSON"),
        None => Settings::default(),
    };
    measure_large();
    let data =
        std::env::var_os("FLOCKSLAM_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    for (name, step_degrees, no_return_m) in LOGS {
        let path = data.join(name).join(format!("{name}.clf"));
        match std::fs::read_to_string(&path) {
            Ok(text) => measure(name, &settings, &scans(&text, step_degrees, no_return_m)),
            Err(problem) => println!("{}: {problem}", Path::display(&path)),
        }
    }
}

/// What describing ten million points costs.
fn measure_large() {
    let ranges: Vec<f32> = (0..10_000_000_u32).map(|i| 4.0 + (i as f32 * 1e-6).sin()).collect();
    let scan = ScanBuffer::from_ranges(&ranges, -3.1, 6.2e-7);
    let view = scan.view().expect("a scan that fits its header");
    for threads in [1, 2] {
        let time_s = |_| {
            let start = Instant::now();
            std::hint::black_box(tally_part(view, 0, 1, threads));
            start.elapsed().as_secs_f64()
        };
        let least_s = (0..9).map(time_s).fold(f64::INFINITY, f64::min);
        println!("10 million points, {threads} threads: {:.2} ms", 1e3 * least_s);
    }
}

fn scans(log: &str, step_degrees: f64, no_return_m: f32) -> Vec<ScanBuffer> {
    let lines = log.lines().filter_map(|line| line.strip_prefix("FLASER "));
    lines
        .map(|line| {
            let mut words = line.split(' ');
            let count = words.next().and_then(|n| n.parse().ok()).expect("a number of beams");
            let mut number = || words.next().and_then(|word| word.parse::<f64>().ok()).expect("a number");
            let ranges: Vec<f32> = (0..count).map(|_| number() as f32).collect();
            let _laser_pose = [number(), number(), number()];
            let step = step_degrees.to_radians();
            let mut scan = ScanBuffer::from_ranges(&ranges, -std::f64::consts::FRAC_PI_2, step);
            scan.header.range_max_m = no_return_m;
            scan.header.odometry = Pose::new(number(), number(), number());
            scan.header.has_odometry = 1;
            scan
        })
        .collect()
}

fn measure(name: &str, settings: &Settings, scans: &[ScanBuffer]) {
    let mut filter = CorrelationFilter::new(settings.clone());
    let mut reasons = BTreeMap::new();
    let start = Instant::now();
    for scan in scans {
        let verdict = filter.handle(scan.view().expect("a scan that fits its header"));
        *reasons.entry(verdict.reason).or_insert(0_u32) += 1;
    }
    let each_us = start.elapsed().as_secs_f64() * 1e6 / scans.len() as f64;
    let share = |count: u32| 100.0 * f64::from(count) / scans.len() as f64;
    let named = |reason: u32| {
        DropReason::from_number(reason)
            .map(DropReason::name)
            .or(KeepReason::from_number(reason).map(KeepReason::name))
    };
    let dropped: u32 =
        reasons.iter().filter(|(r, _)| DropReason::from_number(**r).is_some()).map(|(_, n)| n).sum();
    println!("{name}: {:.1} % of {} scans dropped, {each_us:.2} µs each", share(dropped), scans.len());
    for (reason, count) in reasons {
        println!("    {:12} {:5.1} %", named(reason).unwrap_or("?"), share(count));
    }
}
