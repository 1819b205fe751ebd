//! The pose of a scan that the filter dropped: few of its beams, spread over the scan, are fitted to the grid as it stands. Nothing is inserted
//! and nothing is learned from it, but odometry alone would turn the robot by degrees too far or too little.

use super::fitted::Fitted;
use super::fitting::{Fitter, PRIOR_SIGMA};
use super::points::ScanPoints;
use crate::prediction::Prediction;
use flockslam_geometry::{Covariance, Pose, Twist};
use flockslam_registration::{GaussNewton, ScoreField};

/// Beams of a scan that take part, about.
pub(super) const LIGHT_BEAMS: usize = 64;
/// With fewer points than this odometry is followed.
const LIGHT_POINTS_MIN: usize = 16;
/// Iterations on cells four times, twice and once as wide as the grid's.
const LIGHT_ITERATIONS: [u32; 3] = [3, 2, 3];
/// Farthest that such a fit may be from the predicted pose, metres and radians: a scan that resembles one kept before was taken near it.
const LIGHT_MOVE_MAX: (f64, f64) = (0.15, 0.2);
/// Share of the way from the predicted position to the fitted one: over the short way since a kept scan odometry errs by less than the
/// position by few beams, but its errors add up.
const POSITION_SHARE: f64 = 0.25;

/// Result of a light fit of a scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Light {
    /// In odom.
    pub(super) pose: Pose,
    /// Velocity during the scan, in the robot's own frame.
    pub(super) twist: Twist,
    /// Covariance of the pose.
    pub(super) covariance: Covariance,
}

impl<F: ScoreField> Fitter<'_, F> {
    /// Fits a dropped scan. Its pose, velocity and covariance are used if its points fit about as well as scans usually do. The points are
    /// given back.
    pub(super) fn lightly(self, points: ScanPoints, prediction: Prediction) -> (ScanPoints, Option<Light>) {
        if points.len() < LIGHT_POINTS_MIN {
            return (points, None);
        }
        let solver = GaussNewton { iterations: LIGHT_ITERATIONS };
        let fit = solver.fit(self.field, &points.ends, prediction.pose, prediction.pose);
        let is_usual = fit.score >= self.settings.rescue.below * self.confidence.mean_score;
        let (moved_m, moved_rad) = (fit.pose.distance_m(prediction.pose), fit.pose.turn_rad(prediction.pose));
        if !is_usual || moved_m > LIGHT_MOVE_MAX.0 || moved_rad > LIGHT_MOVE_MAX.1 {
            return (points, None);
        }
        let covariance = fit.covariance(PRIOR_SIGMA.0, PRIOR_SIGMA.1);
        let Fitted { points, fit, twist, covariance, .. } =
            self.with_velocity(Fitted::new(prediction, points, fit, covariance));
        let Pose { x_m, y_m, .. } = prediction.pose;
        let pose = Pose {
            x_m: x_m + POSITION_SHARE * (fit.pose.x_m - x_m),
            y_m: y_m + POSITION_SHARE * (fit.pose.y_m - y_m),
            heading_rad: fit.pose.heading_rad,
        };
        let covariance = Covariance { tt: covariance.tt, xt: 0.0, yt: 0.0, ..prediction.covariance };
        (points, Some(Light { pose, twist, covariance }))
    }
}
