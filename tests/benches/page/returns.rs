//! Returns of a robot to where it has been: how far it drives there until its published pose is near the final one.

use flockslam::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;

/// A robot is where it has been when it is this near to a pose …
pub const KNOWN_M: f64 = 2.0;
/// … that is at least this much travel back.
pub const BACK_M: f64 = 15.0;
/// Poses of the final trajectory are compared this far apart, metres of travel.
const SPACING_M: f64 = 0.25;
/// A published pose is near the final one within this, metres and degrees.
pub const NEAR: (f64, f64) = (0.1, 1.0);
/// Shorter stretches in known surroundings, metres, are crossings and no returns.
pub const RETURN_M: f64 = 2.0;

/// One return.
#[derive(Clone, Copy, Debug)]
pub struct Return {
    /// Way that was driven in known surroundings until the published pose was near the final one, metres; the length of the whole stretch if it
    /// never was.
    pub driven_m: f64,
    /// Whether it came near.
    pub is_corrected: bool,
}

/// The returns in a published trajectory beside the final one of the same scans.
pub fn returns(online: &[TrajectoryPoint], last: &[TrajectoryPoint]) -> Vec<Return> {
    let mut known = Known::default();
    let (mut returns, mut length_m, mut corrected_m) = (Vec::new(), None::<f64>, None);
    let mut end = |length_m: Option<f64>, corrected_m: Option<f64>| {
        if let Some(length_m) = length_m.filter(|length_m| *length_m >= RETURN_M) {
            let (driven_m, is_corrected) = (corrected_m.unwrap_or(length_m), corrected_m.is_some());
            returns.push(Return { driven_m, is_corrected });
        }
    };
    for (published, expected) in online.iter().zip(last) {
        known.drive(expected.map_from_base);
        if known.driven_m.is_none() {
            end(length_m, corrected_m);
            (length_m, corrected_m) = (None, None);
            continue;
        }
        length_m = known.driven_m;
        let off = expected.map_from_base.to(published.map_from_base);
        let is_near =
            off.distance_m(Pose::IDENTITY) <= NEAR.0 && off.heading_rad.abs().to_degrees() <= NEAR.1;
        if is_near && corrected_m.is_none() {
            corrected_m = known.driven_m;
        }
    }
    end(length_m, corrected_m);
    returns
}

/// The poses of a trajectory that lie where the robot had been by then, as the final trajectory says.
pub fn of_later_laps(points: &[TrajectoryPoint], last: &[TrajectoryPoint]) -> Vec<TrajectoryPoint> {
    let mut known = Known::default();
    let is_known = |(_, expected): &(&TrajectoryPoint, &TrajectoryPoint)| {
        known.drive(expected.map_from_base);
        known.driven_m.is_some()
    };
    points.iter().zip(last).filter(is_known).map(|(point, _)| *point).collect()
}

/// How far a robot has driven where it had been before.
#[derive(Default)]
pub struct Known {
    travel_m: f64,
    /// Poses so far, and the travel up to each.
    poses: Vec<(Pose, f64)>,
    /// Way since the robot came to where it had been; `None` where it has not been.
    pub driven_m: Option<f64>,
}

impl Known {
    /// The robot is here now.
    pub fn drive(&mut self, at: Pose) {
        let step_m = self.poses.last().map_or(0.0, |(last, _)| last.distance_m(at));
        if step_m < SPACING_M && !self.poses.is_empty() {
            return;
        }
        self.travel_m += step_m;
        let old = self.poses.partition_point(|(_, travel_m)| *travel_m <= self.travel_m - BACK_M);
        let is_known = self.poses[..old].iter().any(|(pose, _)| pose.distance_m(at) < KNOWN_M);
        self.driven_m = is_known.then(|| self.driven_m.map_or(0.0, |driven_m| driven_m + step_m));
        self.poses.push((at, self.travel_m));
    }
}
