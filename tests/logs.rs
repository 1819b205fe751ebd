//! The three benchmark logs with one configuration: accuracy against their relations, every scan present, the same
//! bytes again, and the published program reproduced by its profile.

mod support;

use std::path::Path;
use std::process::Command;
use support::{Outputs, benchmark_file, data_dir, evaluate_relations, run_well};

struct Log {
    name: &'static str,
    /// Greatest mean translational error over all relations, metres.
    limit_m: f64,
    /// What the published program reaches over short relations, metres.
    published_m: f64,
}

const LOGS: [Log; 3] = [
    Log { name: "intel", limit_m: 0.025, published_m: 0.031 },
    Log { name: "fr079", limit_m: 0.045, published_m: 0.035 },
    Log { name: "aces", limit_m: 0.08, published_m: 0.061 },
];

impl Log {
    fn file(&self, data: &Path, extension: &str) -> std::path::PathBuf {
        benchmark_file(data, self.name, extension)
    }

    fn map(&self, data: &Path, out: &Path, more: &[&str]) -> Outputs {
        let mut args = vec!["map".to_owned(), self.file(data, "clf").display().to_string()];
        args.extend(more.iter().map(|arg| (*arg).to_owned()));
        run_well(self.name, out, &args)
    }

    /// Stamps of the log's scans as they stand in the file, in its order: the third field from the end.
    fn stamps(&self, data: &Path) -> Vec<String> {
        let text = std::fs::read(self.file(data, "clf")).unwrap();
        let text = String::from_utf8_lossy(&text);
        let scans =
            text.lines().filter(|line| line.starts_with("FLASER ") || line.starts_with("ROBOTLASER1 "));
        scans.map(|line| line.split_ascii_whitespace().rev().nth(2).unwrap().to_owned()).collect()
    }
}

fn mean_m(group: &serde_json::Value) -> f64 {
    group["translation_m"]["mean"].as_f64().unwrap()
}

#[test]
fn one_configuration_maps_all_logs_accurately() {
    let Some(data) = data_dir() else { return };
    for log in &LOGS {
        let directory = tempfile::tempdir().unwrap();
        let outputs = log.map(&data, directory.path(), &[]);
        let figures = evaluate_relations(&data, log.name, &outputs);
        let (mean, short, loops) =
            (mean_m(&figures["all"]), mean_m(&figures["short"]), mean_m(&figures["loop"]));
        println!(
            "{}: all {mean:.4} m (at most {} m), short {short:.4} m, loops {loops:.4} m; {:.0} scans/s",
            log.name, log.limit_m, outputs.report.scans_per_s
        );
        assert!(mean <= log.limit_m, "{}: {mean} m", log.name);
        assert_eq!(figures["all"]["missing"], 0);
        agrees_with_the_reference_evaluator(log, &data, &outputs, &figures);
        let stamps = log.stamps(&data);
        for name in ["trajectory.tum", "trajectory_online.tum"] {
            assert!(outputs.stamps(name) == stamps, "{}: {name} has other stamps than the log", log.name);
        }
        assert_eq!(outputs.report.scans as usize, stamps.len());
    }
}

fn agrees_with_the_reference_evaluator(
    log: &Log,
    data: &Path,
    outputs: &Outputs,
    figures: &serde_json::Value,
) {
    let script = data.join("../tools/relations.py");
    let mut command = Command::new("python3");
    command.arg(&script).arg(outputs.directory.join("trajectory.tum")).arg(log.file(data, "relations"));
    let output = match command.output() {
        Ok(output) if output.status.success() => output,
        _ => return println!("NOT TESTED: no python3 or no {}", script.display()),
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
    let Some(data) = data_dir() else { return };
    let log = &LOGS[1];
    let directories = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [first, second] = directories.each_ref().map(|directory| log.map(&data, directory.path(), &[]));
    for name in ["trajectory.tum", "trajectory_online.tum", "map.pgm", "map.yaml"] {
        assert!(first.bytes(name) == second.bytes(name), "{name} differs");
    }
    assert_eq!(first.report.map_hash, second.report.map_hash);
}

#[test]
fn the_profile_of_the_published_program_reproduces_its_error() {
    let Some(data) = data_dir() else { return };
    for log in &LOGS {
        let directory = tempfile::tempdir().unwrap();
        let outputs = log.map(&data, directory.path(), &["--profile", "vinyslam"]);
        let short_m = mean_m(&evaluate_relations(&data, log.name, &outputs)["short"]);
        let ratio = short_m / log.published_m;
        println!(
            "{} as vinySLAM: short {short_m:.4} m, published {} m ({ratio:.2})",
            log.name, log.published_m
        );
        assert!((0.75..=1.25).contains(&ratio), "{}: {short_m} m", log.name);
    }
}
