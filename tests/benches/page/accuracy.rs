//! Section `accuracy`: errors of the final trajectory on each log and in the simulated building, beside published figures.

use super::runs::{Errors, Measured, Outcome, Subject, set};
use super::{Bench, Table, figure, greatest, mean};
use std::rc::Rc;

/// What was asked of this program, and what others reached: log, error over all relations, rotation.
const REFERENCES: [(&str, [&str; 3]); 7] = [
    (
        "asked of flockslam, mean of the headings",
        ["0.0140 m / 0.21°", "0.0300 m / 0.42°", "0.0345 m / 0.33°, loops 0.05 m"],
    ),
    (
        "Cartographer, published, tuned for each log (Hess et al. 2016)",
        ["0.0229 m / 0.453°", "0.0452 m / 0.538°", "0.0375 m / 0.373°"],
    ),
    ("graph FLIRT, published (Tipaldi, Arras 2010)", ["0.020 m", "–", "–"]),
    (
        "Cartographer, run on these files",
        ["0.0207 m", "0.0304 m / 0.435° (weights changed for this log)", "0.0425 m / 0.40°"],
    ),
    ("Hector's core with odometry, 2.5 cm cells, run on these files", ["0.0179 m / 0.245°", "–", "–"]),
    ("Karto, run on these files", ["–", "–", "0.050 m"]),
    (
        "noise of the relations themselves, from their cycles",
        ["about 0.013 m / 0.20°", "0.019 m / 0.27°", "0.032 m / 0.31°"],
    ),
];

/// Accuracy with one configuration.
pub fn section(bench: &mut Bench) -> String {
    let mut table = Table::new([
        "",
        "trajectory",
        "all",
        "worst heading",
        "short",
        "loops",
        "loops, worst",
        "rotation",
        "maximum",
        "missing",
    ]);
    for log in bench.logs.clone() {
        for (filter, mode) in [("", Some("correlation")), (", filter off", None)] {
            let name = format!("{}{filter}", log.name);
            let options = |heading: f64| {
                let mode = mode.map(|mode| set(&[&format!("correlation_filter.mode={mode}")]));
                mode.into_iter().flatten().chain(start(heading)).collect::<Vec<_>>()
            };
            let headings = bench.plan.headings_rad.clone();
            let runs: Vec<_> =
                headings.iter().map(|heading| bench.runs.of(&log, &options(*heading))).collect();
            table_rows(&mut table, &name, "final", &runs, |run| Some(run.last));
            table_rows(&mut table, &name, "online", &runs, |run| Some(run.online));
        }
    }
    format!(
        "{}`flockslam map LOG`, and the same with `--set correlation_filter.mode=off`: all scans are matched. All other settings are the defaults, the same for every log. Metres and degrees; means over \
         {} start headings ({} rad, `--set lidar_ingest.start_pose=[0.0,0.0,H]`), which lay the log differently on the grid; beside them the worst of these runs. *Maximum* is \
         the largest error of any relation in any run, *missing* counts relations without a pose.\n\n{table}\n{}\n{}",
        bench.absence(),
        bench.plan.headings_rad.len(),
        bench.plan.headings_rad.iter().map(|h| format!("{h}")).collect::<Vec<_>>().join(", "),
        references(),
        building(bench),
    )
}

/// Options that start the run at a heading; 0 is the log as it is.
pub fn start(heading_rad: f64) -> Vec<String> {
    if heading_rad == 0.0 {
        return Vec::new();
    }
    set(&[&format!("lidar_ingest.start_pose=[0.0,0.0,{heading_rad:?}]")])
}

fn table_rows(
    table: &mut Table,
    name: &str,
    trajectory: &str,
    runs: &[Outcome],
    errors: impl Fn(&Rc<Measured>) -> Option<Errors>,
) {
    if let Some(Err(reason)) = runs.iter().find(|run| run.is_err()) {
        return table.row([name, trajectory, &format!("failed: {reason}")]);
    }
    let errors: Vec<Errors> = runs.iter().flatten().filter_map(errors).collect();
    let of = |value: fn(&Errors) -> f64| errors.iter().map(value).collect::<Vec<_>>();
    let (all, loops) = (of(Errors::translation_m), of(Errors::loop_m));
    table.row([
        name.to_owned(),
        trajectory.to_owned(),
        figure(mean(&all), 4),
        figure(greatest(&all), 4),
        figure(mean(&of(Errors::short_m)), 4),
        figure(mean(&loops), 4),
        figure(greatest(&loops), 4),
        figure(mean(&of(Errors::rotation_deg)), 3),
        figure(greatest(&of(Errors::max_m)), 2),
        errors.iter().map(Errors::missing).max().unwrap_or(0).to_string(),
    ]);
}

fn references() -> String {
    let mut table = Table::new(["mean over all relations", "Intel", "FR079", "ACES"]);
    for (name, figures) in REFERENCES {
        table.row([name].into_iter().chain(figures));
    }
    table.to_string()
}

fn building(bench: &mut Bench) -> String {
    let mut table =
        Table::new(["trajectory", "ATE", "worst drive", "error per metre", "rotation", "maximum"]);
    let building = bench.building.clone();
    let drives = bench.plan.headings_rad.len();
    let runs: Vec<_> = (1..=drives).map(|seed| bench.runs.of(&building, &seeded(seed))).collect();
    let failed = runs.iter().find_map(|run| run.as_ref().err());
    if let Some(reason) = failed {
        table.row(["final", &format!("failed: {reason}")]);
    } else {
        building_row(&mut table, "final", &runs, |run| run.last);
        building_row(&mut table, "online", &runs, |run| run.online);
    }
    format!(
        "Simulated building, {} s of driving with wheels that slip, {drives} drives (`flockslam demo --set simulation.seed=N`), against exact truth:\n\n{table}",
        bench.plan.simulated_s
    )
}

/// The options of a drive of its own; seed 1 is the default.
pub fn seeded(seed: usize) -> Vec<String> {
    if seed == 1 { Vec::new() } else { set(&[&format!("simulation.seed={seed}")]) }
}

fn building_row(table: &mut Table, name: &str, runs: &[Outcome], errors: impl Fn(&Measured) -> Errors) {
    let errors: Vec<Errors> = runs.iter().flatten().map(|run| errors(run)).collect();
    let of = |value: fn(&Errors) -> f64| errors.iter().map(value).collect::<Vec<_>>();
    let ate = of(Errors::translation_m);
    table.row([
        name.to_owned(),
        figure(mean(&ate), 4),
        figure(greatest(&ate), 4),
        figure(mean(&of(Errors::short_m)), 4),
        figure(mean(&of(Errors::rotation_deg)), 3),
        figure(greatest(&of(Errors::max_m)), 2),
    ]);
}

/// A subject's plain run, which others are compared with.
pub fn plain(bench: &mut Bench, subject: &Subject) -> Outcome {
    bench.runs.of(subject, &[])
}
