//! A predicted pose with its covariance, and its fusion with a fit (the update of a Kalman filter).

use flockslam_geometry::{Covariance, Pose, Twist, wrap_angle};
use flockslam_registration::TwistSigma;
use nalgebra::{Matrix3, Vector3};

/// Error of the grid itself, standard deviations in metres and radians: a pose this near to the prediction is as probable.
const GRID_SIGMA: (f64, f64) = (0.01, 0.003);
/// Cost of the assumption that wheels have slipped, in units of the negative logarithm of a probability: errors of odometry are
/// normally distributed for the most part, but any error is possible at this cost.
pub(crate) const SLIP_COST: f64 = 10.0;

/// A predicted pose with its uncertainty.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prediction {
    pub(crate) pose: Pose,
    /// Velocity since the scan before, in the robot's own frame.
    pub(crate) twist: Twist,
    /// How sure the velocity is where odometry measured it during the scan.
    pub(crate) measured: Option<TwistSigma>,
    /// Scans are missing between this one and the one before, and odometry does not say that the robot stood: it may have gone anywhere near.
    pub(crate) after_gap: bool,
    pub(crate) covariance: Covariance,
    /// Covariance that the motion since the scan before adds.
    pub(crate) step: Covariance,
    /// The pose by the velocity so far, if it differs much from odometry, which may have jumped.
    pub(crate) steady: Option<Steady>,
    /// The motion since the scan before if the robot went on at its velocity, where it has odometry.
    pub(crate) coasting: Option<Coasting>,
    /// Wheels slip: the pose is by the velocity, not by odometry.
    pub(crate) is_coasting: bool,
}

/// A motion from one scan to the next at a constant velocity.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coasting {
    pub(crate) pose: Pose,
    pub(crate) twist: Twist,
    /// Standard deviation of the position along each axis after it, metres.
    pub(crate) sigma_m: f64,
}

/// The pose if the robot went on at its velocity.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steady {
    pub(crate) pose: Pose,
    pub(crate) twist: Twist,
}

pub(crate) fn matrix(c: Covariance) -> Matrix3<f64> {
    Matrix3::new(c.xx, c.xy, c.xt, c.xy, c.yy, c.yt, c.xt, c.yt, c.tt)
}

impl Prediction {
    /// How improbable a pose is by the prediction alone: the negative logarithm of its probability density relative to the
    /// predicted pose's, at most [`SLIP_COST`].
    pub(crate) fn cost(&self, pose: Pose) -> f64 {
        let grid = Covariance::diagonal(GRID_SIGMA.0, GRID_SIGMA.1);
        let missed = Vector3::new(
            pose.x_m - self.pose.x_m,
            pose.y_m - self.pose.y_m,
            wrap_angle(pose.heading_rad - self.pose.heading_rad),
        );
        let Some(factor) = (matrix(self.covariance) + matrix(grid)).cholesky() else { return 0.0 };
        (0.5 * missed.dot(&factor.solve(&missed))).min(SLIP_COST)
    }

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
