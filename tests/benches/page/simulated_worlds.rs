//! Section `worlds`: drives through simulated worlds, and how well covariances agree with errors.

use super::runs::{Errors, Outcome};
use super::{Bench, Subject, Table, figure, greatest, mean, simulated};
use flockslam_drives::nees::nees_of_run;

/// A world to drive through several times with different noise.
struct Drive {
    what: &'static str,
    settings: &'static [&'static str],
    seeds: usize,
    asked: &'static str,
}

/// Each further row of the table is one more of these.
const DRIVES: [Drive; 3] = [
    Drive {
        what: "hotel: parallel corridors with identical rooms, 1 km and more",
        settings: &["simulation.world=hotel", "simulation.duration_s=1290"],
        seeds: 2,
        asked: "ATE < 0.05 m, no false closure",
    },
    Drive {
        what: "warehouse: parallel aisles between identical racks, 1 km and more",
        settings: &["simulation.world=warehouse", "simulation.duration_s=1290"],
        seeds: 2,
        asked: "ATE < 0.05 m, no false closure",
    },
    Drive {
        what: "yard: outdoors, most beams return nothing",
        settings: &["simulation.world=yard", "simulation.duration_s=520"],
        seeds: 2,
        asked: "tracked, or reported as degraded",
    },
];

/// Independent drives for the consistency of covariances.
const NEES_DRIVES: u64 = 50;

/// Worlds that are made to mislead, and a long run.
pub fn section(bench: &mut Bench) -> String {
    let mut table = Table::new([
        "",
        "asked",
        "driven m",
        "ATE",
        "worst drive",
        "maximum",
        "online ATE",
        "closures accepted",
        "revoked",
        "CPU per scan ms",
    ]);
    for drive in &DRIVES {
        let subject = simulated(drive.what, drive.settings);
        let seeds = if bench.plan.patient { drive.seeds } else { 1 };
        let runs: Vec<_> = (1..=seeds)
            .map(|seed| bench.runs.of(&filterless(&subject), &super::accuracy::seeded(seed)))
            .collect();
        row(&mut table, drive, &runs);
    }
    let text = format!(
        "`flockslam demo` with `simulation.world`, filter off, against exact truth; means over the seeds of the drive. A false closure would show as an error of metres.\n\n{table}"
    );
    if bench.plan.patient { text + "\n" + &consistency() } else { text }
}

/// How far poses are off against what their covariance says.
fn consistency() -> String {
    let mut all: Vec<f64> = (0..NEES_DRIVES).map(nees_of_run).collect();
    all.sort_by(f64::total_cmp);
    let mut table = Table::new(["NEES", "mean", "median", "greatest"]);
    table.row([
        "measured".to_owned(),
        figure(mean(&all), 2),
        figure(all[all.len() / 2], 2),
        figure(greatest(&all), 1),
    ]);
    table.row(["asked", "2.36 … 3.72"]);
    format!(
        "Normalised estimation error squared of the last pose of {NEES_DRIVES} independent drives through two buildings, three degrees of freedom; scans enter the map at \
         their true poses, since the covariance is that of the pose against the map (`tests/published_covariance.rs`):\n\n{table}"
    )
}

fn filterless(subject: &Subject) -> Subject {
    let mut subject = subject.clone();
    subject.options.extend(super::runs::set(&["correlation_filter.mode=off"]));
    subject
}

fn row(table: &mut Table, drive: &Drive, runs: &[Outcome]) {
    if let Some(reason) = runs.iter().find_map(|run| run.as_ref().err()) {
        return table.row([drive.what, drive.asked, &format!("failed: {reason}")]);
    }
    let runs: Vec<_> = runs.iter().flatten().collect();
    let of = |value: fn(&Errors) -> f64| runs.iter().map(|run| value(&run.last)).collect::<Vec<_>>();
    let report = |value: fn(&flockslam::outputs::Report) -> f64| {
        runs.iter().map(|run| value(&run.report)).collect::<Vec<_>>()
    };
    let online: Vec<f64> = runs.iter().map(|run| run.online.translation_m()).collect();
    let cpu: Vec<f64> = runs.iter().map(|run| run.cpu_ms_per_scan()).collect();
    let ate = of(Errors::translation_m);
    table.row([
        drive.what.to_owned(),
        drive.asked.to_owned(),
        figure(mean(&report(|report| report.trajectory_length_m)), 0),
        figure(mean(&ate), 4),
        figure(greatest(&ate), 4),
        figure(greatest(&of(Errors::max_m)), 2),
        figure(mean(&online), 4),
        figure(mean(&report(|report| report.loop_closures.accepted as f64)), 0),
        figure(mean(&report(|report| report.loop_closures.revoked as f64)), 0),
        figure(mean(&cpu), 3),
    ]);
}
