//! Prediction of the next pose from odometry or the last velocity, with its covariance, and its fusion with a fit (the
//! update of a Kalman filter).

use flockslam_geometry::{Covariance, Pose, Twist, wrap_angle};
use flockslam_messages::ScanView;
use nalgebra::{Matrix3, Vector3};

/// Seconds between scans, assumed before two stamps are known and for steps that are not positive.
const PERIOD_START_S: f64 = 0.1;
/// Longest step between stamps that is accepted, seconds.
const PERIOD_MAX_S: f64 = 2.0;
/// A first odometry pose farther from the origin than this is not taken over, metres.
const START_MAX_M: f64 = 1e4;
/// Growth of a predicted position's variance per metre travelled, m²/m: 0.1 m after half a metre on poor wheels.
const DRIFT_XY: f64 = 0.02;
/// Growth of a predicted heading's variance per radian turned, rad²/rad.
const DRIFT_HEADING: f64 = 0.01;

/// Odometry that differs by more than this from the velocity so far, metres and radians within one scan, may have jumped.
const SURPRISE: (f64, f64) = (0.15, 0.15);

/// Added in each step, standard deviations in metres and radians: for odometry, and for the velocity so far
/// without odometry.
const STEP_SIGMA: (f64, f64) = (0.01, 0.005);
const STEP_SIGMA_BLIND: (f64, f64) = (0.15, 0.1);

/// Share of the velocity that remains after each rejected scan.
const KEPT_WHEN_LOST: f64 = 0.5;

fn scaled(twist: Twist, share: f64) -> Twist {
    Twist { x_m_s: share * twist.x_m_s, y_m_s: share * twist.y_m_s, turn_rad_s: share * twist.turn_rad_s }
}

/// Predicts the pose from the last pose and odometry, or from the last velocity without odometry.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    pub(crate) pose: Pose,
    pub(crate) covariance: Covariance,
    odometry: Option<Pose>,
    stamp_ns: Option<i64>,
    period_s: f64,
    velocity: Twist,
}

/// Whether a first pose is near enough to the origin to count in centimetres from there.
fn is_near(pose: Pose) -> bool {
    pose.x_m.abs() < START_MAX_M && pose.y_m.abs() < START_MAX_M
}

/// A predicted pose with its uncertainty.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prediction {
    pub(crate) pose: Pose,
    /// Velocity since the scan before, in the robot's own frame.
    pub(crate) twist: Twist,
    pub(crate) covariance: Covariance,
    /// The pose by the velocity so far, if it differs much from odometry, which may have jumped.
    pub(crate) steady: Option<Steady>,
}

/// The pose if the robot went on at its velocity.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steady {
    pub(crate) pose: Pose,
    pub(crate) twist: Twist,
}

fn matrix(c: Covariance) -> Matrix3<f64> {
    Matrix3::new(c.xx, c.xy, c.xt, c.xy, c.yy, c.yt, c.xt, c.yt, c.tt)
}

impl Prediction {
    /// Fuses a fit that is less certain than the prediction in some direction with it (the update of a Kalman filter):
    /// pose and covariance. `None` where the fit is more certain in all directions: then slipping wheels shall not pull the pose.
    pub(crate) fn fused(&self, fit: Pose, covariance: Covariance) -> Option<(Pose, Covariance)> {
        let of_fit = matrix(covariance);
        let of_motion = matrix(self.covariance);
        let holds_in_all_directions = (of_motion - of_fit).cholesky().is_some();
        if holds_in_all_directions {
            return None;
        }
        let gain = of_fit * (of_fit + of_motion).try_inverse()?;
        let missed = Vector3::new(
            self.pose.x_m - fit.x_m,
            self.pose.y_m - fit.y_m,
            wrap_angle(self.pose.heading_rad - fit.heading_rad),
        );
        let shift = gain * missed;
        let left = of_fit - gain * of_fit;
        let pose = Pose::new(fit.x_m + shift.x, fit.y_m + shift.y, fit.heading_rad + shift.z);
        let [xy, xt, yt] = [(0, 1), (0, 2), (1, 2)].map(|(i, j)| 0.5 * (left[(i, j)] + left[(j, i)]));
        Some((pose, Covariance { xx: left[(0, 0)], xy, xt, yy: left[(1, 1)], yt, tt: left[(2, 2)] }))
    }
}

impl Motion {
    pub(crate) fn new() -> Self {
        Self {
            pose: Pose::IDENTITY,
            covariance: Covariance::default(),
            odometry: None,
            stamp_ns: None,
            period_s: PERIOD_START_S,
            velocity: Twist::default(),
        }
    }

    /// Continues at a pose whose scan had this odometry and stamp.
    pub(crate) fn resume(
        &mut self,
        pose: Pose,
        covariance: Covariance,
        odometry: Option<Pose>,
        stamp_ns: i64,
    ) {
        *self = Self { pose, covariance, odometry, stamp_ns: Some(stamp_ns), ..Self::new() };
    }

    /// The pose at this scan as it follows from the one before. Odometry is a motion in the robot's own frame, so
    /// composing it turns it into the corrected heading.
    pub(crate) fn predict(&self, scan: ScanView<'_>) -> Prediction {
        let placed = scan.header().starts_at_odometry == 1;
        if let (None, true, Some(start)) =
            (self.stamp_ns, placed, scan.odometry().filter(|start| is_near(*start)))
        {
            let (twist, covariance) = (Twist::default(), self.covariance);
            return Prediction { pose: start, twist, covariance, steady: None };
        }
        let step_s = self.step_s(scan.header().times.sensor_ns);
        let unchanged = self.velocity.motion_after(self.even(step_s));
        let (motion, twist) = match (self.odometry, scan.odometry()) {
            (Some(before), Some(now)) => (before.to(now), Twist::from_motion(before.to(now), step_s)),
            _ => (unchanged, self.velocity),
        };
        let surprises = motion.distance_m(unchanged) > SURPRISE.0 || motion.turn_rad(unchanged) > SURPRISE.1;
        let steady = surprises.then(|| Steady { pose: self.pose * unchanged, twist: self.velocity });
        let (travel, turn) = (motion.x_m.hypot(motion.y_m), motion.heading_rad.abs());
        let mut covariance = self.covariance;
        let (step_m, step_rad) = if scan.odometry().is_some() { STEP_SIGMA } else { STEP_SIGMA_BLIND };
        let position = DRIFT_XY * travel + self.covariance.tt * travel * travel + step_m * step_m;
        covariance.xx += position;
        covariance.yy += position;
        covariance.tt += DRIFT_HEADING * turn + step_rad * step_rad;
        Prediction { pose: self.pose * motion, twist, covariance, steady }
    }

    /// Updates the state after a scan. The velocity of a `lost` robot is unknown: it fades, or
    /// without odometry it would be predicted out of the map.
    pub(crate) fn advance(&mut self, scan: ScanView<'_>, pose: Pose, covariance: Covariance, lost: bool) {
        let stamp_ns = scan.header().times.sensor_ns;
        let step_s = self.step_s(stamp_ns);
        if self.stamp_ns.is_some() {
            let kept = if lost { KEPT_WHEN_LOST } else { 1.0 };
            self.velocity = scaled(Twist::from_motion(self.pose.to(pose), self.even(step_s)), kept);
            self.period_s += 0.05 * (step_s - self.period_s);
        }
        self.pose = pose;
        self.covariance = covariance;
        self.odometry = scan.odometry();
        self.stamp_ns = Some(stamp_ns);
    }

    /// A step between stamps that jitter, kept near the nominal period: scans come at even times even if their stamps do
    /// not, and a velocity over a step far too short would be far too great.
    fn even(&self, step_s: f64) -> f64 {
        step_s.clamp(0.5 * self.period_s, 2.0 * self.period_s)
    }

    /// Seconds since the scan before; the nominal period when the stamps do not step forward.
    fn step_s(&self, stamp_ns: i64) -> f64 {
        let Some(before) = self.stamp_ns else { return self.period_s };
        let step = stamp_ns.saturating_sub(before) as f64 * 1e-9;
        if step > 0.0 && step <= PERIOD_MAX_S { step } else { self.period_s }
    }
}
