//! Section `robustness`: errors on logs that are spoilt on purpose, beside the plain run and the limit that was asked for.

use super::accuracy::plain;
use super::runs::{Outcome, set};
use super::{Bench, Table, figure};

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
        let unspoilt = plain(bench, &log);
        let unspoilt_m = unspoilt.as_ref().map_or(f64::NAN, |run| run.last.translation_m());
        row(&mut table, &log.name, "plain", &unspoilt, unspoilt_m, "");
        for experiment in &EXPERIMENTS {
            let outcome = bench.runs.of(&log, &set(experiment.settings));
            let asked = experiment.asked.text(&log.name);
            row(&mut table, &log.name, experiment.what, &outcome, unspoilt_m, &asked);
        }
    }
    let settings = EXPERIMENTS.iter().map(|e| format!("{} – `{}`", e.what, e.settings.join("`, `")));
    format!(
        "One start heading; `--set` of the experiment beside `correlation_filter.mode=off`: {}. Withheld scans get a predicted pose, so that every relation counts. \
         Metres and degrees; in the simulated building *all* is the ATE and *short* the error per metre.\n\n{table}",
        settings.collect::<Vec<_>>().join("; ")
    )
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

fn row(table: &mut Table, log: &str, what: &str, outcome: &Outcome, plain_m: f64, asked: &str) {
    match outcome {
        Err(reason) => table.row([log, what, &format!("failed: {reason}"), "", asked]),
        Ok(run) => table.row([
            log.to_owned(),
            what.to_owned(),
            figure(run.last.translation_m(), 4),
            figure(run.last.translation_m() / plain_m, 2),
            asked.to_owned(),
            figure(run.last.short_m(), 4),
            figure(run.last.loop_m(), 4),
            figure(run.last.rotation_deg(), 3),
            figure(run.last.max_m(), 2),
        ]),
    }
}
