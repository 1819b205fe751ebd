//! The three benchmark logs with one configuration: accuracy against their relations, every scan present, the same
//! bytes again, and the published program reproduced by its profile.

use crate::support::public_logs::{ACES, FR079, INTEL, LOGS, Log, assert_no_worse};
use crate::support::{Outputs, data_dir, evaluate_relations, not_tested};
use std::path::Path;
use std::process::Command;

/// What default settings reach at start heading 0: mean errors over all relations, metres and degrees, and over loops, metres.
const REACHED: [(Log, f64, f64, f64); 3] =
    [(INTEL, 0.0127, 0.2075, 0.0151), (FR079, 0.0299, 0.419, 0.0403), (ACES, 0.0332, 0.315, 0.0483)];

/// Stamps of the log's scans as they stand in the file, in its order: the third field from the end.
fn stamps(log: &Log) -> Vec<String> {
    let text = std::fs::read(log.file("clf").unwrap()).unwrap();
    let text = String::from_utf8_lossy(&text);
    let scans = text.lines().filter(|line| line.starts_with("FLASER ") || line.starts_with("ROBOTLASER1 "));
    scans.map(|line| line.split_ascii_whitespace().rev().nth(2).unwrap().to_owned()).collect()
}

#[test]
fn default_settings_map_each_log_as_accurately_as_before() {
    for (log, reached_m, reached_deg, reached_loop_m) in REACHED {
        let Some(run) = log.shared_run(&[]) else { return };
        let errors = log.errors(run.wait());
        let figures =
            [(errors.mean_m, reached_m), (errors.mean_deg, reached_deg), (errors.loop_m, reached_loop_m)];
        assert_no_worse(&log, &errors, &figures);
    }
}

/// The metres and the degrees, where there are any, in the row of README's table that begins so, log by log.
fn readme_figures(row: &str) -> Vec<Vec<f64>> {
    let readme = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../README.md")).unwrap();
    let line = readme.lines().find(|line| line.starts_with(&format!("| {row} |"))).unwrap().to_owned();
    let cells = line.trim_matches('|').split('|').skip(1);
    let number = |figure: &str| figure.trim().trim_end_matches([' ', 'm', '°']).parse().unwrap();
    cells.map(|cell| cell.split(',').map(number).collect()).collect()
}

#[test]
fn readme_states_the_accuracy_that_default_settings_have() {
    let (all, loops) =
        (readme_figures("final trajectory"), readme_figures("of these, loops of 60 s and more"));
    for (i, log) in LOGS.iter().enumerate() {
        let Some(run) = log.shared_run(&[]) else { return };
        let errors = log.errors(run.wait());
        let measured = [errors.mean_m, errors.mean_deg, errors.loop_m];
        for (stated, measured) in all[i].iter().chain(&loops[i]).zip(measured) {
            assert!(
                (stated / measured - 1.0).abs() < 0.1,
                "{}: {stated} stated, {measured} measured",
                log.name
            );
        }
    }
}

#[test]
fn each_scan_of_a_log_has_a_line_with_its_stamp_in_both_trajectories() {
    for log in LOGS {
        let Some(run) = log.shared_run(&[]) else { return };
        let (outputs, stamps) = (run.wait(), stamps(&log));
        for name in ["trajectory.tum", "trajectory_online.tum"] {
            assert!(outputs.stamps(name) == stamps, "{}: {name} has other stamps than the log", log.name);
        }
        assert_eq!(outputs.report.scans as usize, stamps.len());
    }
}

#[test]
fn figures_agree_with_those_of_an_independent_evaluator() {
    for log in LOGS {
        let Some(run) = log.shared_run(&[]) else { return };
        agrees_with_the_reference_evaluator(&log, run.wait());
    }
}

fn agrees_with_the_reference_evaluator(log: &Log, outputs: &Outputs) {
    let data = data_dir().unwrap();
    let figures = evaluate_relations(&data, log.name, outputs);
    let script = data.join("../tools/relations.py");
    let mut command = Command::new("python3");
    command.arg(&script).arg(outputs.directory.join("trajectory.tum")).arg(log.file("relations").unwrap());
    let output = match command.output() {
        Ok(output) if output.status.success() => output,
        _ => {
            let reason = format!("there is no python3 or no {}", script.display());
            return not_tested("the independent evaluator", &reason);
        }
    };
    let reference: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for group in ["all", "short", "loop"] {
        let (own, other) = (&figures[group], &reference[group]);
        assert_eq!((&own["n"], &own["missing"]), (&other["n"], &other["missing"]), "{group}");
        for (kind, short, tolerance) in [("translation_m", 't', 2e-5), ("rotation_deg", 'r', 2e-4)] {
            for (figure, factor) in [("mean", 1.0), ("std", 1.0), ("max", 10.0)] {
                let own = own[kind][figure].as_f64().unwrap();
                let other = other[format!("{short}_{figure}")].as_f64().unwrap();
                assert!((own - other).abs() <= factor * tolerance, "{group} {kind} {figure}: {own}, {other}");
            }
        }
    }
}

#[test]
fn a_log_gives_the_same_bytes_again() {
    // The largest map of the three.
    let Some(first) = ACES.shared_run(&[]) else { return };
    let (first, directory) = (first.wait(), tempfile::tempdir().unwrap());
    let second = Log::map(&ACES.file("clf").unwrap(), directory.path(), &[]);
    for name in ["trajectory.tum", "trajectory_online.tum", "map.pgm", "map.yaml", "map.png"] {
        assert!(first.bytes(name) == second.bytes(name), "{name} differs");
    }
    assert_eq!(first.report.map_hash, second.report.map_hash);
}

#[test]
fn the_profile_of_the_published_program_reproduces_its_error() {
    for log in LOGS {
        let Some(run) = log.shared_run(&["--profile", "vinyslam"]) else { return };
        let short_m = log.errors(run.wait()).short_m;
        let ratio = short_m / log.published_m;
        println!(
            "{} as vinySLAM: short {short_m:.4} m, published {} m ({ratio:.2})",
            log.name, log.published_m
        );
        assert!((0.75..=1.25).contains(&ratio), "{}: {short_m} m", log.name);
    }
}
