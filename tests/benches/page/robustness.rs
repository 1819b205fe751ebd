//! Section `robustness`: errors on logs that are spoilt on purpose, beside the plain run and the limit that was asked for.

use super::runs::{Errors, Measured, Subject, set};
use super::{Bench, Table, figure, greatest, mean};
use std::rc::Rc;

/// An experiment on the source, and what was asked of the error under it.
struct Experiment {
    what: &'static str,
    settings: &'static [&'static str],
    asked: Asked,
}

enum Asked {
    /// At most this, metres, on these logs.
    Metres(f64, &'static [&'static str]),
    /// At most this times the error of the plain run.
    Times(f64),
}

const EXPERIMENTS: [Experiment; 6] = [
    Experiment {
        what: "no odometry",
        settings: &["lidar_ingest.odometry=false"],
        asked: Asked::Metres(0.06, &["Intel", "FR079", "ACES"]),
    },
    Experiment {
        what: "every second scan withheld",
        settings: &["lidar_ingest.keep_every=2"],
        asked: Asked::Times(1.3),
    },
    Experiment {
        what: "20 % of the beams replaced by noise",
        settings: &["lidar_ingest.beam_noise_share=0.2"],
        asked: Asked::Times(1.5),
    },
    Experiment {
        what: "odometry with 2 cm and 1° of noise per scan",
        settings: &["lidar_ingest.odometry_noise=[0.02,1.0]"],
        asked: Asked::Times(1.3),
    },
    Experiment {
        what: "five odometry jumps of up to 1 m and 90°, seed 1",
        settings: &["lidar_ingest.odometry_jumps=5", "lidar_ingest.seed=1"],
        asked: Asked::Times(1.3),
    },
    Experiment {
        what: "the same, seed 2",
        settings: &["lidar_ingest.odometry_jumps=5", "lidar_ingest.seed=2"],
        asked: Asked::Times(1.3),
    },
];

/// A log that is spoilt on purpose, against the same log as it is.
pub fn section(bench: &mut Bench) -> String {
    let mut table =
        Table::new(["", "experiment", "all", "× plain", "asked", "short", "loops", "rotation", "maximum"]);
    for log in bench.subjects() {
        let drives = drives(bench, &log);
        let unspoilt = runs(bench, &log, &drives, &[]);
        let unspoilt_m = unspoilt.as_ref().map_or(f64::NAN, |runs| mean_of(runs, Errors::translation_m));
        row(&mut table, &log.name, "plain", &unspoilt, unspoilt_m, "");
        for experiment in &EXPERIMENTS {
            let outcome = runs(bench, &log, &drives, experiment.settings);
            let asked = experiment.asked.text(&log.name);
            row(&mut table, &log.name, experiment.what, &outcome, unspoilt_m, &asked);
        }
    }
    let settings = EXPERIMENTS.iter().map(|e| format!("{} – `{}`", e.what, e.settings.join("`, `")));
    format!(
        "One start heading; in the simulated building means over {} drives (`simulation.seed`), since errors of millimetres depend on the drive. `--set` of the experiment beside `correlation_filter.mode=off`: {}. Withheld scans get a predicted pose, so that every relation counts. \
         Metres and degrees; in the simulated building *all* is the ATE and *short* the error per metre.\n\n{table}",
        bench.plan.headings_rad.len(),
        settings.collect::<Vec<_>>().join("; ")
    )
}

/// Settings of the drives that a subject stands for: a log is one, the simulation as many as there are seeds.
fn drives(bench: &Bench, subject: &Subject) -> Vec<Vec<String>> {
    if subject.log.is_some() {
        return vec![Vec::new()];
    }
    (1..=bench.plan.headings_rad.len()).map(|seed| set(&[&format!("simulation.seed={seed}")])).collect()
}

/// The runs of an experiment over these drives, or why one of them failed.
fn runs(
    bench: &mut Bench,
    subject: &Subject,
    drives: &[Vec<String>],
    settings: &[&str],
) -> Result<Vec<Rc<Measured>>, String> {
    let options = |drive: &Vec<String>| [drive.clone(), set(settings)].concat();
    drives.iter().map(|drive| bench.runs.of(subject, &options(drive))).collect()
}

fn mean_of(runs: &[Rc<Measured>], error: impl Fn(&Errors) -> f64) -> f64 {
    mean(&runs.iter().map(|run| error(&run.last)).collect::<Vec<_>>())
}

impl Asked {
    fn text(&self, log: &str) -> String {
        match self {
            Self::Metres(metres, logs) if logs.contains(&log) => format!("≤ {metres} m"),
            Self::Metres(..) => String::new(),
            Self::Times(times) => format!("≤ {times} ×"),
        }
    }
}

fn row(
    table: &mut Table,
    log: &str,
    what: &str,
    outcome: &Result<Vec<Rc<Measured>>, String>,
    plain_m: f64,
    asked: &str,
) {
    let runs = match outcome {
        Err(reason) => return table.row([log, what, &format!("failed: {reason}"), "", asked]),
        Ok(runs) => runs,
    };
    let largest_m: Vec<f64> = runs.iter().map(|run| run.last.max_m()).collect();
    table.row([
        log.to_owned(),
        what.to_owned(),
        figure(mean_of(runs, Errors::translation_m), 4),
        figure(mean_of(runs, Errors::translation_m) / plain_m, 2),
        asked.to_owned(),
        figure(mean_of(runs, Errors::short_m), 4),
        figure(mean_of(runs, Errors::loop_m), 4),
        figure(mean_of(runs, Errors::rotation_deg), 3),
        figure(greatest(&largest_m), 2),
    ]);
}
