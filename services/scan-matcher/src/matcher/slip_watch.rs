//! Wheels that slip in the open: the robot may have gone on as before while odometry shows a turn.
//!
//! A single scan of one tree decides nothing there. So both motions are followed over several scans, each fitted to the surfaces around, until
//! one explains them clearly better.

use super::surroundings::prior;
use crate::prediction::{Prediction, SLIP_COST};
use flockslam_geometry::elementary::hypot;
use flockslam_geometry::{Covariance, Point, Pose, Twist, wrap_angle};
use flockslam_messages::ScanView;
use flockslam_registration::SurfaceMap;

/// A change of the turn by odometry that is greater than this may be a slip, rad/s: wheels on a floor turn a robot by so much within two
/// scans too, which the scans then show.
const SURPRISE_RAD_S: f64 = 0.15;
/// Scans farther apart than this, seconds, show a change in one step, and of the first scan of a slip only a part …
const SLOW_S: f64 = 0.25;
/// … so a smaller change counts, rad/s; but a robot whose wheels turn it less than before does not go on turning.
const SLOW_SURPRISE_RAD_S: f64 = 0.08;
/// A robot that goes on as before does so within these standard deviations, m/s and rad/s.
const STEADY_SIGMA: (f64, f64) = (0.1, 0.1);
/// A second assumption of a slip, soon after the first was confirmed, costs less.
const AGAIN_COST: f64 = 2.0;
/// So far after its start, metres of travel, a slip is over.
const TRAVEL_MAX_M: f64 = 2.5;
/// Poses nearer than this are the same, metres and radians.
const SAME: (f64, f64) = (0.1, 0.02);
/// Odometry must hold less than this share of the points that the alternative holds.
const POOR_SHARE: f64 = 0.6;
/// Where so much speaks for the alternative, a greater share is enough: wide surfaces hold many points of a robot that is turned by several degrees.
const CLEAR_GAIN: f64 = 60.0;
const CLEAR_SHARE: f64 = 0.85;
/// Among plants a robot that has turned by more than this share of its field of view is not judged: much of what it sees was not seen before.
const VIEW_SHARE: f64 = 0.33;
/// Standard deviations of a pose that an alternative gives, metres where the velocity gives none, and radians.
const SIGMA: (f64, f64) = (0.1, 0.15);

/// A scan as it was placed.
#[derive(Clone, Copy, Debug)]
struct Placed {
    stamp_ns: i64,
    pose: Pose,
    odometry: Pose,
    /// The motion to it, by odometry.
    twist: Twist,
}

/// The robot if its wheels have slipped.
#[derive(Clone, Copy, Debug)]
struct Alternative {
    pose: Pose,
    /// The motion before the slip.
    twist: Twist,
    /// Logarithm of the ratio of the likelihoods, of both motions and of the scans since.
    gain: f64,
    /// Points on surfaces, there and by odometry, and all points.
    held: [f64; 2],
    points: f64,
    travel_m: f64,
    was_right: bool,
    /// The slip is over: odometry shows its motion again.
    follows: bool,
    /// Heading before the slip, radians.
    begin_rad: f64,
}

/// A scan while it is open how the robot moved.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlipStep {
    /// The alternative at the scan before.
    alternative: Alternative,
    /// The motion since by odometry.
    odometry_step: Pose,
    /// How long it took.
    step_s: f64,
}

/// Follows a robot whose wheels may slip.
#[derive(Debug, Default)]
pub(super) struct SlipWatch {
    /// The last two scans, the newest first.
    last: [Option<Placed>; 2],
    alternative: Option<Alternative>,
}

impl SlipWatch {
    /// Clears all.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Whether it is open how the robot moved.
    pub(super) fn is_undecided(&self) -> bool {
        self.alternative.is_some()
    }

    /// A scan was placed here.
    pub(super) fn placed(&mut self, scan: ScanView<'_>, pose: Pose) {
        let Some(odometry) = scan.odometry() else { return self.clear() };
        let stamp_ns = scan.header().times.sensor_ns;
        let step = self.last[0].map(|last| (last.odometry.to(odometry), last.seconds_to(stamp_ns)));
        let twist = match step {
            Some((motion, Some(step_s))) => Twist::from_motion(motion, step_s),
            _ => Twist::default(),
        };
        self.last = [Some(Placed { stamp_ns, pose, odometry, twist }), self.last[0]];
    }

    /// Whether a scan may tell of a slip: what [`Self::decide`] needs then. Otherwise odometry is used from here on.
    pub(super) fn step(&mut self, scan: ScanView<'_>) -> Option<SlipStep> {
        let step = self.begun(scan);
        self.alternative = step.map(|step| step.alternative);
        step
    }

    /// The prediction of a scan with these points (frame of the robot), or that of the alternative if it explains the scans better. Unless
    /// much speaks for it, it has to hold at least `share_min` of their points. `view_rad` is the lidar's field of view.
    pub(super) fn decide(
        &mut self,
        step: SlipStep,
        points: &[Point],
        map: &SurfaceMap,
        prediction: Prediction,
        share_min: f64,
        view_rad: f64,
    ) -> Prediction {
        let SlipStep { alternative, odometry_step, step_s } = step;
        if points.is_empty() || map.is_empty() {
            let pose = alternative.pose * alternative.twist.motion_after(step_s);
            self.alternative = Some(Alternative { pose, ..alternative });
            return prediction;
        }
        let turned_rad = wrap_angle(prediction.pose.heading_rad - alternative.begin_rad).abs();
        if share_min > 0.0 && turned_rad > VIEW_SHARE * view_rad {
            self.alternative = None;
            return prediction;
        }
        let explained = |pose: Pose, step: Covariance| map.explained(points, &prior(pose, step));
        let ours = explained(prediction.pose, prediction.step);
        let goes_on = alternative.pose * alternative.twist.motion_after(step_s);
        let steady = Covariance::diagonal(STEADY_SIGMA.0 * step_s, STEADY_SIGMA.1 * step_s);
        let [coasting, following] = [(goes_on, steady), (alternative.pose * odometry_step, prediction.step)]
            .map(|(pose, step)| explained(pose, step));
        // A slip begins with a motion that odometry does not show, and ends once. Scans that follow fast do not tell when.
        let begins = alternative.points == 0.0 && !alternative.was_right && step_s > SLOW_S;
        let has_ended = alternative.follows && step_s > SLOW_S;
        let follows = !begins && (has_ended || following.cost < coasting.cost);
        let theirs = if follows { following } else { coasting };
        let now = Alternative {
            pose: theirs.pose,
            gain: alternative.gain + ours.cost - theirs.cost,
            held: [alternative.held[0] + theirs.weights, alternative.held[1] + ours.weights],
            points: alternative.points + points.len() as f64,
            follows,
            ..alternative
        };
        let cost = if now.was_right { AGAIN_COST } else { SLIP_COST };
        let is_poor = |share: f64| now.held[1] < share * now.held[0];
        let is_held = is_poor(POOR_SHARE) && now.held[0] >= share_min * now.points
            || now.gain >= CLEAR_GAIN && is_poor(CLEAR_SHARE);
        if now.gain >= cost && is_held {
            self.alternative =
                Some(Alternative { gain: 0.0, held: [0.0; 2], points: 0.0, was_right: true, ..now });
            let sigma_m = prediction.coasting.map_or(SIGMA.0, |coasting| coasting.sigma_m);
            let covariance = Covariance::diagonal(sigma_m, SIGMA.1);
            let twist = Twist { turn_rad_s: now.twist.turn_rad_s, ..prediction.twist };
            return Prediction {
                pose: theirs.pose,
                twist,
                measured: None,
                steady: None,
                is_coasting: true,
                covariance,
                ..prediction
            };
        }
        let is_same = theirs.pose.distance_m(ours.pose) < SAME.0 && theirs.pose.turn_rad(ours.pose) < SAME.1;
        let is_over = now.gain < -SLIP_COST || (is_same && !now.was_right);
        // What was right once begins again at the pose that was decided on.
        let pose = if now.was_right && now.gain < 0.0 { ours.pose } else { now.pose };
        let gain = if now.was_right { now.gain.max(0.0) } else { now.gain };
        self.alternative = (!is_over || now.was_right).then_some(Alternative { pose, gain, ..now });
        prediction
    }

    fn begun(&self, scan: ScanView<'_>) -> Option<SlipStep> {
        let (odometry, last) = scan.odometry().zip(self.last[0])?;
        let step_s = last.seconds_to(scan.header().times.sensor_ns)?;
        let odometry_step = last.odometry.to(odometry);
        let travel_m = hypot(odometry_step.x_m, odometry_step.y_m);
        if let Some(alternative) = self.alternative {
            let alternative = Alternative { travel_m: alternative.travel_m + travel_m, ..alternative };
            return (alternative.travel_m < TRAVEL_MAX_M).then_some(SlipStep {
                alternative,
                odometry_step,
                step_s,
            });
        }
        let before = if step_s > SLOW_S { Some(last) } else { self.last[1] }?;
        let turn_rad_s = Twist::from_motion(odometry_step, step_s).turn_rad_s;
        let before_rad_s = before.twist.turn_rad_s;
        let change_rad_s = (turn_rad_s - before_rad_s).abs();
        let surprises = if step_s > SLOW_S {
            let slows_down = turn_rad_s * before_rad_s > 0.0 && turn_rad_s.abs() < before_rad_s.abs();
            change_rad_s > SLOW_SURPRISE_RAD_S && !slows_down
        } else {
            change_rad_s > SURPRISE_RAD_S
        };
        let until_last_s = if step_s > SLOW_S { 0.0 } else { before.seconds_to(last.stamp_ns)? };
        let alternative = Alternative {
            pose: before.pose * before.twist.motion_after(until_last_s),
            twist: before.twist,
            gain: 0.0,
            held: [0.0; 2],
            points: 0.0,
            travel_m,
            was_right: false,
            follows: false,
            begin_rad: before.pose.heading_rad,
        };
        surprises.then_some(SlipStep { alternative, odometry_step, step_s })
    }
}

impl Placed {
    /// Seconds to a later stamp, if they make a velocity.
    fn seconds_to(&self, stamp_ns: i64) -> Option<f64> {
        let seconds = stamp_ns.saturating_sub(self.stamp_ns) as f64 * 1e-9;
        (1e-3..=2.0).contains(&seconds).then_some(seconds)
    }
}
