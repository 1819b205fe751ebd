//! A robot that is switched on at an unknown pose looks for itself in a known map, with exact odometry.

use flockslam_evidence::CellState;
use flockslam_localisation::{Agreement, Knowledge, Localizer, SeenPoint};
use flockslam_loop_closure::scans::ScanStore;
use flockslam_registration::cloud::Placement;
use std::time::{Duration, Instant};

/// A robot looks around after so much travel and turning, metres and radians.
const VIEW: (f64, f64) = (0.3, 0.35);
/// A robot gives up after this way, and is followed over this one once it is found, metres.
const WAY_M: (f64, f64) = (40.0, 18.0);

/// How one robot has fared.
#[derive(Debug, Default)]
pub struct StartTrial {
    /// Way in mapped space until it was found.
    pub found_after_m: Option<f64>,
    pub mapped_m: f64,
    /// It was said to be where it was not: where it was, and where it was said to be.
    pub false_place: Option<(Placement, Placement)>,
    pub was_lost: bool,
    pub was_ambiguous: bool,
    pub slowest: Duration,
    /// Distances from the truth while it was localized, metres.
    pub errors_m: Vec<f64>,
    /// How what it saw from each place agrees with the map at the true pose.
    pub at_truth: Vec<Agreement>,
}

/// Lets a robot drive the way from its start, and records when it is localized; a pose that is found farther from the truth than `false_from`, metres
/// and radians, is false. `None`: the robot is in another building, and whatever is found is false.
pub fn start_trial(
    localizer: &mut Localizer,
    way: &[Placement],
    scans: &[usize],
    store: &ScanStore,
    false_from: Option<(f64, f64)>,
) -> StartTrial {
    localizer.odometry_breaks();
    let odom_from_map = Placement::new(3.0, -7.0, 1.9);
    let mut trial = StartTrial::default();
    let (mut last, mut travel_m, mut followed_m) = (None::<Placement>, 0.0, 0.0);
    for (truth, scan) in way.iter().zip(scans) {
        if last.is_some_and(|last| last.distance_m(truth) < VIEW.0 && last.turn_rad(truth) < VIEW.1) {
            continue;
        }
        let step_m = last.map_or(0.0, |last| last.distance_m(truth));
        last = Some(*truth);
        travel_m += step_m;
        let is_mapped = localizer.surroundings().map().at(truth.x_m, truth.y_m).state == CellState::Free;
        trial.mapped_m += if is_mapped { step_m } else { 0.0 };
        let points: Vec<SeenPoint> = store
            .points(*scan)
            .iter()
            .map(|point| SeenPoint { x_m: point.x_m(), y_m: point.y_m(), from_x_m: 0.0, from_y_m: 0.0 })
            .collect();
        trial.at_truth.push(localizer.surroundings().agreement(&points, truth));
        let started = Instant::now();
        let belief = localizer.see(odom_from_map.compose(*truth), store.points(*scan));
        trial.slowest = trial.slowest.max(started.elapsed());
        if belief.knowledge == Knowledge::Localized {
            trial.found_after_m.get_or_insert(trial.mapped_m);
            let found = belief.hypotheses[0].map_from_base;
            let is_true = |(m, rad)| found.distance_m(truth) <= m && found.turn_rad(truth) <= rad;
            if !false_from.is_some_and(is_true) {
                trial.false_place = Some((*truth, found));
            }
            trial.errors_m.push(found.distance_m(truth));
            followed_m += step_m;
        } else {
            trial.was_lost |= trial.found_after_m.is_some();
            trial.was_ambiguous |= belief.knowledge == Knowledge::Ambiguous;
        }
        if trial.false_place.is_some() || trial.was_lost || followed_m > WAY_M.1 || travel_m > WAY_M.0 {
            break;
        }
    }
    trial
}
