//! Damaged input: a log with bad beams and bad lines, and repetitions of one drive.

use super::{Seeded, Trial};
use crate::support::{building, run_well};
use flockslam::evaluation::{evaluate_truth, parse_tum};
use flockslam_lidar_ingest::carmen::write_scan;
use flockslam_messages::ScanBuffer;
use flockslam_simulation::{Settings, Simulation, World};
use std::fmt::Write;
use std::fs;

/// Share of the beams of each scan that say something else than what is there.
const BAD_SHARE_PERCENT: u64 = 30;
/// What a bad beam says when it is no number between nothing and the longest range.
const GARBAGE: [&str; 6] = ["nan", "inf", "-inf", "-1.0", "0.0", "1e30"];
/// Of so many lines one is broken off, has a wrong number of beams, or comes out of order.
const BAD_LINE_EVERY: u64 = 40;
/// An old scan comes so many scans late: 3 s.
const OLD: usize = 30;

/// A drive of a minute, as a log: its lines, and its truth as a trajectory.
fn drive() -> (Vec<String>, String) {
    let settings = Settings { duration_s: 60.0, beams: 180, ..Settings::default() };
    let mut simulation = Simulation::new(&settings, World::floor_plan()).unwrap();
    let (mut scan, mut lines, mut truth) = (ScanBuffer::default(), Vec::new(), String::new());
    while let Some(pose) = simulation.next_scan(&mut scan) {
        let mut line = Vec::new();
        write_scan(&mut line, scan.view().unwrap()).unwrap();
        lines.push(String::from_utf8(line).unwrap());
        let stamp_s = scan.header.times.sensor_ns as f64 * 1e-9;
        let (sin, cos) = (0.5 * pose.heading_rad).sin_cos();
        writeln!(truth, "{stamp_s:.6} {} {} 0 0 0 {sin} {cos}", pose.x_m, pose.y_m).unwrap();
    }
    (lines, truth)
}

/// The fields of a line of a scan are its kind, seven of the lidar, the number of beams, and the beams.
const FIELDS_BEFORE_BEAMS: usize = 9;

fn spoilt(line: &str, random: &mut Seeded) -> String {
    let mut fields: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
    let beams: usize = fields[FIELDS_BEFORE_BEAMS - 1].parse().unwrap();
    for field in &mut fields[FIELDS_BEFORE_BEAMS..FIELDS_BEFORE_BEAMS + beams] {
        if random.below(100) < BAD_SHARE_PERCENT {
            *field = match random.below(2 * GARBAGE.len() as u64) as usize {
                kind if kind < GARBAGE.len() => GARBAGE[kind].to_owned(),
                _ => format!("{:.2}", 0.12 * random.below(100) as f64),
            };
        }
    }
    fields.join(" ") + "\n"
}

/// Bad beams in every scan, and lines that are no scans between them.
fn corrupt(lines: &[String], random: &mut Seeded) -> String {
    let mut log = String::new();
    for (number, line) in lines.iter().enumerate() {
        let spoilt = spoilt(line, random);
        if random.below(BAD_LINE_EVERY) == 0 {
            match random.below(if number < OLD { 2 } else { 3 }) {
                0 => writeln!(log, "{}", &spoilt[..spoilt.len() / 2]).unwrap(),
                1 => log.push_str(&spoilt.replacen(" 180 ", " 181 ", 1)),
                _ => log.push_str(&lines[number - OLD]),
            }
        }
        log.push_str(&spoilt);
    }
    log
}

/// Error of the map run of a log against the truth, and the scans that were rejected, with how many reasons.
fn error_of(log: &str, truth: &str) -> (f64, u64, usize) {
    let directory = tempfile::tempdir().unwrap();
    let (path, out) = (directory.path().join("drive.clf"), directory.path().join("out"));
    fs::write(&path, log).unwrap();
    let share = "lidar_ingest.max_bad_line_share=0.2".to_owned();
    let args = ["map".to_owned(), path.to_string_lossy().into_owned(), "--set".to_owned(), share];
    let outputs = run_well("corrupt", &out, &args);
    let report: serde_json::Value = serde_json::from_slice(&outputs.bytes("report.json")).unwrap();
    let reasons = report["rejected"].as_object().cloned().unwrap_or_default();
    let rejected = reasons.values().filter_map(serde_json::Value::as_u64).sum();
    let truth = parse_tum("truth", truth.as_bytes()).unwrap();
    let report = evaluate_truth(&outputs.trajectory("trajectory.tum"), &truth).unwrap();
    (report.absolute.translation_m.unwrap().rmse, rejected, reasons.len())
}

/// Scans with many bad beams, broken lines, and scans that come twice, with each of the seeds: the error is the mean, which depends on
/// the seed by half.
pub fn corrupt_scans(seeds: std::ops::Range<u64>) -> Trial {
    let (lines, truth) = drive();
    let (calm_m, _, _) = error_of(&lines.concat(), &truth);
    let mut trial =
        Trial { fault: format!("{BAD_SHARE_PERCENT} % bad beams, bad lines"), ..Trial::default() };
    let mut errors_m = Vec::new();
    for seed in seeds {
        let log = corrupt(&lines, &mut Seeded::new(seed));
        let (error_m, rejected, reasons) = error_of(&log, &truth);
        errors_m.push(error_m);
        let bad_lines = log.lines().count() - lines.len();
        trial.runs += lines.len() + bad_lines;
        if rejected != bad_lines as u64 || reasons == 0 {
            trial.violations.push(format!("{bad_lines} lines were bad, {rejected} were rejected"));
        }
    }
    trial.error_m = Some((errors_m.iter().sum::<f64>() / errors_m.len() as f64, calm_m));
    trial
}

/// The same drive again and again, which must leave the same bytes.
pub fn repetitions(runs: usize) -> Trial {
    let mut trial = Trial { fault: "the same drive again".to_owned(), runs, ..Trial::default() };
    let mut hashes: Vec<String> = (0..runs)
        .map(|_| {
            let directory = tempfile::tempdir().unwrap();
            run_well("again", directory.path(), &building(20)).report.map_hash
        })
        .collect();
    hashes.sort();
    hashes.dedup();
    if hashes.len() != 1 {
        trial.violations.push(format!("{} different maps", hashes.len()));
    }
    trial
}
