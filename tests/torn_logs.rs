//! The benchmark logs with every scan processed, as they are and made harder: accuracy, odometry that jumps, beams that lie,
//! scans that are missing, and a robot that is carried elsewhere.

mod support;

use flockslam_geometry::Pose;
use std::fmt::Write;
use std::path::Path;
use support::{Outputs, benchmark_file, data_dir, evaluate_relations, run_well};

struct Log {
    name: &'static str,
    /// Greatest mean error over all relations, metres and degrees.
    limit: (f64, f64),
    /// Where the log is cut: the robot is carried from before the first scan to the second.
    cut: (usize, usize),
}

const LOGS: [Log; 3] = [
    Log { name: "intel", limit: (0.0140, 0.225), cut: (4000, 7000) },
    Log { name: "fr079", limit: (0.0305, 0.43), cut: (2000, 2600) },
    Log { name: "aces", limit: (0.0345, 0.33), cut: (3500, 4500) },
];

/// Errors of a final trajectory.
#[derive(Debug)]
struct Errors {
    mean_m: f64,
    mean_deg: f64,
    max_m: f64,
    loop_max_m: f64,
    missing: u64,
}

impl Log {
    fn file(&self, data: &Path, extension: &str) -> std::path::PathBuf {
        benchmark_file(data, self.name, extension)
    }

    /// Maps a log with every scan processed.
    fn map(log: &Path, out: &Path, more: &[&str]) -> Outputs {
        let mut args = vec![
            "map".to_owned(),
            log.display().to_string(),
            "--set".into(),
            "correlation_filter.mode=off".into(),
        ];
        args.extend(more.iter().flat_map(|assignment| ["--set".to_owned(), (*assignment).to_owned()]));
        run_well("torn", out, &args)
    }

    fn errors(&self, data: &Path, outputs: &Outputs) -> Errors {
        let figures = evaluate_relations(data, self.name, outputs);
        let all = &figures["all"];
        let number = |kind: &str, figure: &str| all[kind][figure].as_f64().unwrap();
        Errors {
            mean_m: number("translation_m", "mean"),
            mean_deg: number("rotation_deg", "mean"),
            max_m: number("translation_m", "max"),
            loop_max_m: figures["loop"]["translation_m"]["max"].as_f64().unwrap(),
            missing: all["missing"].as_u64().unwrap(),
        }
    }

    /// Runs the log so, and demands errors of at most `factor` times the limit and no failed loop.
    fn demand(&self, data: &Path, factor: f64, more: &[&str]) {
        let directory = tempfile::tempdir().unwrap();
        let outputs = Self::map(&self.file(data, "clf"), directory.path(), more);
        let errors = self.errors(data, &outputs);
        println!("{} {more:?}: {errors:?}", self.name);
        assert!(errors.mean_m <= factor * self.limit.0, "{} {more:?}: {errors:?}", self.name);
        assert!(errors.loop_max_m < 0.5 && errors.missing == 0, "{} {more:?}: {errors:?}", self.name);
        // Where the second scan of a relation is withheld, its pose is what the neighbours say: a second of hard turning may be off.
        let withheld = more.iter().any(|setting| setting.contains("keep_every"));
        assert!(withheld || errors.max_m < 0.5, "{} {more:?}: {errors:?}", self.name);
        if more.is_empty() {
            assert!(errors.mean_deg <= self.limit.1, "{}: {errors:?}", self.name);
        }
    }
}

#[test]
fn every_scan_processed_reaches_the_accuracy_promised() {
    let Some(data) = data_dir() else { return };
    LOGS.iter().for_each(|log| log.demand(&data, 1.0, &[]));
}

#[test]
fn odometry_that_jumps_costs_no_loop() {
    let Some(data) = data_dir() else { return };
    for log in &LOGS {
        log.demand(&data, 1.3, &["lidar_ingest.odometry_jumps=5", "lidar_ingest.seed=7"]);
    }
}

#[test]
fn false_beams_missing_scans_and_poor_wheels_cost_little() {
    let Some(data) = data_dir() else { return };
    for log in &LOGS {
        log.demand(&data, 1.5, &["lidar_ingest.beam_noise_share=0.2"]);
        log.demand(&data, 1.3, &["lidar_ingest.keep_every=2"]);
        log.demand(&data, 1.3, &["lidar_ingest.odometry_noise=[0.02, 1.0]"]);
    }
}

#[test]
fn a_robot_carried_elsewhere_finds_its_own_past() {
    let Some(data) = data_dir() else { return };
    for log in &LOGS {
        let directory = tempfile::tempdir().unwrap();
        let cut = directory.path().join("cut.clf");
        std::fs::write(&cut, carried(&log.file(&data, "clf"), log.cut)).unwrap();
        let outputs = Log::map(&cut, &directory.path().join("out"), &[]);
        let errors = log.errors(&data, &outputs);
        println!("{} carried: {errors:?}, {} chains", log.name, outputs.report.chains);
        assert!(errors.mean_m <= 1.1 * log.limit.0 && errors.max_m < 0.5, "{}: {errors:?}", log.name);
        assert!(outputs.report.chains >= 2, "{}: nobody noticed", log.name);
        assert_eq!(outputs.report.detached_scans, 0, "{}: never found again", log.name);
    }
}

/// The log without the scans between, while its wheels notice nothing.
fn carried(log: &Path, (first, second): (usize, usize)) -> String {
    let text = String::from_utf8_lossy(&std::fs::read(log).unwrap()).into_owned();
    let scans: Vec<&str> = text.lines().filter(|line| line.starts_with("FLASER ")).collect();
    let (before, after) = (wheels(scans[first - 1]), wheels(scans[second]));
    let change = before * after.inverse();
    let mut out = String::new();
    scans[..first].iter().for_each(|line| writeln!(out, "{line}").unwrap());
    for line in &scans[second..] {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let ranges = 2 + words[1].parse::<usize>().unwrap();
        let at = |i: usize| Pose::new(number(words[i]), number(words[i + 1]), number(words[i + 2]));
        out.push_str(&words[..ranges].join(" "));
        for pose in [change * at(ranges), change * at(ranges + 3)] {
            write!(out, " {:.6} {:.6} {:.6}", pose.x_m, pose.y_m, pose.heading_rad).unwrap();
        }
        writeln!(out, " {}", words[ranges + 6..].join(" ")).unwrap();
    }
    out
}

fn number(word: &str) -> f64 {
    word.parse().unwrap()
}

/// Pose by the wheels in a FLASER line.
fn wheels(line: &str) -> Pose {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let place = 5 + words[1].parse::<usize>().unwrap();
    Pose::new(number(words[place]), number(words[place + 1]), number(words[place + 2]))
}
