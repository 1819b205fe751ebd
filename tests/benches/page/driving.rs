//! Section `driving`: the poses that a robot drives by, beside the final ones, and what corrections make of them.

use super::accuracy::start;
use super::returns::{BACK_M, KNOWN_M, Known, NEAR, RETURN_M, Return};
use super::runs::{Measured, Outcome};
use super::{Bench, Table, duration, figure, greatest, mean, simulated};
use flockslam::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
use std::rc::Rc;

/// Steps of the published pose that the final trajectory does not make count as jumps from here on, metres: fits scatter by less.
const JUMP_M: f64 = 0.1;
/// Length of the drives in hotel and warehouse, seconds: two laps and more.
const WORLD_S: f64 = 1290.0;

/// A jump of the published pose: a correction.
#[derive(Clone, Copy, Debug)]
pub struct Jump {
    /// Its length, metres.
    pub size_m: f64,
    /// Way that was driven in known surroundings before it came, metres; `None` where the robot had not been.
    pub known_m: Option<f64>,
}

/// The jumps of a published trajectory beside the final one of the same scans.
pub fn jumps(online: &[TrajectoryPoint], last: &[TrajectoryPoint]) -> Vec<Jump> {
    let step = |points: &[TrajectoryPoint]| points[0].map_from_base.to(points[1].map_from_base);
    let mut known = Known::default();
    let mut jumps = Vec::new();
    for (said, meant) in online.windows(2).zip(last.windows(2)) {
        known.drive(meant[0].map_from_base);
        let off = step(meant).to(step(said));
        let size_m = off.distance_m(Pose::IDENTITY);
        if size_m > JUMP_M {
            jumps.push(Jump { size_m, known_m: known.driven_m });
        }
    }
    jumps
}

/// Published poses beside final ones.
pub fn section(bench: &mut Bench) -> String {
    let mut table = Table::new([
        "",
        "online, all",
        "final, all",
        "online, loops",
        "final, loops",
        "online, rotation",
        "final, rotation",
        "jumps",
        "median size",
        "greatest",
        "driven where it had been before a jump, median",
        "95 %",
    ]);
    let mut returns_table = Table::new([
        "",
        "returns",
        "driven until near, median, m",
        "95 %",
        "not near before they ended",
        "later laps, online, m",
        "later laps, final, m",
    ]);
    for log in bench.logs.clone() {
        let headings = bench.plan.headings_rad.clone();
        let runs: Vec<_> = headings.iter().map(|heading| bench.runs.of(&log, &start(*heading))).collect();
        table.row(row(&log.name, &runs));
        returns_table.row(returns_row(&log.name, &runs));
    }
    let world = |name: &str| {
        let (world, seconds) = (format!("simulation.world={name}"), duration(WORLD_S));
        simulated(&format!("simulated {name}"), &["correlation_filter.mode=off", &world, &seconds])
    };
    for subject in [bench.building.clone(), world("hotel"), world("warehouse")] {
        let runs = [bench.runs.of(&subject, &[])];
        table.row(row(&subject.name, &runs));
        returns_table.row(returns_row(&subject.name, &runs));
    }
    format!(
        "{}The pose that a robot had when a scan was handled: the front end's, with the correction known at the time (`trajectory_online.tum`); the final \
         trajectory beside it. Runs as under *Accuracy*; metres and degrees, means over their start headings; in simulated buildings *all* is the ATE. In replay a correction \
         takes effect four scans after the one that it follows from; live it comes within milliseconds. A *jump* is a step of the published pose, more than {JUMP_M} m off the \
         step of the final trajectory: counted in all runs. The last columns say how far the robot had driven within {KNOWN_M} m of poses that lay {BACK_M} m of travel back, when a jump came \
         there. What was driven before the first loop was closed stays as far off as it was: no correction changes a pose that was published.\n\n{table}\n\
         All returns to known surroundings, over {RETURN_M} m or more, those without a jump too: the way driven there until the published pose was within {} m and {}° of the final \
         one; the whole length of the return if it never was. *Later laps*: the ATE of the poses in known surroundings, where the truth is known.\n\n{returns_table}",
        bench.absence(),
        NEAR.0,
        NEAR.1,
    )
}

fn row(name: &str, runs: &[Outcome]) -> Vec<String> {
    if let Some(Err(reason)) = runs.iter().find(|run| run.is_err()) {
        return vec![name.to_owned(), format!("failed: {reason}")];
    }
    let runs: Vec<&Rc<Measured>> = runs.iter().flatten().collect();
    let of = |value: &dyn Fn(&Measured) -> f64| mean(&runs.iter().map(|run| value(run)).collect::<Vec<_>>());
    let jumps: Vec<Jump> = runs.iter().flat_map(|run| run.jumps.iter().copied()).collect();
    let sizes_m: Vec<f64> = jumps.iter().map(|jump| jump.size_m).collect();
    let known_m: Vec<f64> = jumps.iter().filter_map(|jump| jump.known_m).collect();
    vec![
        name.to_owned(),
        figure(of(&|run| run.online.translation_m()), 4),
        figure(of(&|run| run.last.translation_m()), 4),
        figure(of(&|run| run.online.loop_m()), 4),
        figure(of(&|run| run.last.loop_m()), 4),
        figure(of(&|run| run.online.rotation_deg()), 3),
        figure(of(&|run| run.last.rotation_deg()), 3),
        jumps.len().to_string(),
        figure(quantile(&sizes_m, 0.5), 2),
        figure(greatest(&sizes_m), 2),
        figure(quantile(&known_m, 0.5), 1),
        figure(quantile(&known_m, 0.95), 1),
    ]
}

fn returns_row(name: &str, runs: &[Outcome]) -> Vec<String> {
    let runs: Vec<&Rc<Measured>> = runs.iter().flatten().collect();
    let returns: Vec<Return> = runs.iter().flat_map(|run| run.returns.iter().copied()).collect();
    let driven_m: Vec<f64> = returns.iter().map(|one| one.driven_m).collect();
    let later =
        |of: usize| mean(&runs.iter().filter_map(|run| Some(run.later_laps_m?[of])).collect::<Vec<_>>());
    vec![
        name.to_owned(),
        returns.len().to_string(),
        figure(quantile(&driven_m, 0.5), 1),
        figure(quantile(&driven_m, 0.95), 1),
        returns.iter().filter(|one| !one.is_corrected).count().to_string(),
        figure(later(0), 4),
        figure(later(1), 4),
    ]
}

/// The value that so large a share does not exceed.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(place.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}
