//! Prints which share of the benchmark logs the filter drops with its default settings, and what a verdict costs.
//!
//! `cargo run --release -p flockslam-correlation-filter --example drop_share`; the logs are looked for in the folder
//! named by FLOCKSLAM_DATA, else in `../shared/data`. Settings may be given as one JSON argument.

use flockslam_correlation_filter::{CorrelationFilter, Settings};
use flockslam_messages::ScanBuffer;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Name of a log, degrees between its beams, and the range that means no return.
const LOGS: [(&str, f64, f32); 3] = [("intel", 1.0, 80.0), ("fr079", 0.5, 80.0), ("aces", 1.0, 49.0)];

fn main() {
    let settings = match std::env::args().nth(1) {
        Some(json) => serde_json::from_str(&json).expect("settings as JSON"),
        None => Settings::default(),
    };
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

fn scans(log: &str, step_degrees: f64, no_return_m: f32) -> Vec<ScanBuffer> {
    let lines = log.lines().filter_map(|line| line.strip_prefix("FLASER "));
    lines
        .map(|line| {
            let mut words = line.split(' ');
            let count = words.next().and_then(|n| n.parse().ok()).expect("a number of beams");
            let ranges: Vec<f32> = words.take(count).map(|r| r.parse().expect("a range")).collect();
            let step = step_degrees.to_radians();
            let mut scan = ScanBuffer::from_ranges(&ranges, -std::f64::consts::FRAC_PI_2, step);
            scan.header.range_max_m = no_return_m;
            scan
        })
        .collect()
}

fn measure(name: &str, settings: &Settings, scans: &[ScanBuffer]) {
    let mut filter = CorrelationFilter::new(settings.clone());
    let start = Instant::now();
    let keep = |scan: &ScanBuffer| filter.handle(scan.view().expect("a scan that fits its header")).keep;
    let kept: u32 = scans.iter().map(keep).sum();
    let each_us = start.elapsed().as_secs_f64() * 1e6 / scans.len() as f64;
    let dropped = 100.0 * (1.0 - f64::from(kept) / scans.len() as f64);
    println!("{name}: {dropped:.1} % of {} scans dropped, {each_us:.2} µs each", scans.len());
}
