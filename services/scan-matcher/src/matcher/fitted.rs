//! A scan fitted to the grid: pose, velocity, and what they are worth.

use super::fitting::Alternative;
use super::points::ScanPoints;
use crate::prediction::Prediction;
use flockslam_geometry::{Covariance, Pose, Twist};
use flockslam_registration::Fit;

/// A scan fitted to the grid.
#[derive(Debug)]
pub(super) struct Fitted {
    /// Where the fit began: by odometry, or by the velocity so far where odometry has jumped.
    pub(super) prediction: Prediction,
    /// The points that were fitted, straightened by `twist`.
    pub(super) points: ScanPoints,
    /// Pose in odom, with its score.
    pub(super) fit: Fit,
    /// Velocity during the scan, in the robot's own frame.
    pub(super) twist: Twist,
    /// Covariance of the pose.
    pub(super) covariance: Covariance,
    /// The pose that the scan alone gives near the prediction, and its covariance as the fit claims it.
    pub(super) alone: Option<(Pose, Covariance)>,
    /// Whether a wide search found it.
    pub(super) is_rescued: bool,
    /// Whether it is less certain than the prediction in some direction, and was fused with it.
    pub(super) is_fused: bool,
    /// Whether no match is good enough to reject odometry: the scan keeps the predicted pose.
    pub(super) is_predicted: bool,
    /// Centre of the last wide search, if no fit was good since.
    pub(super) searched: Option<Pose>,
    /// The pose that fits better than the predicted one, but is not accepted yet.
    pub(super) alternative: Option<Alternative>,
    /// Whether the pose is that of the surfaces around, as the grid does not hold the scan.
    pub(super) is_open: bool,
}

impl Fitted {
    /// A fit of the pose alone, near the prediction, with the covariance that it claims.
    pub(super) fn new(prediction: Prediction, points: ScanPoints, fit: Fit, covariance: Covariance) -> Self {
        Self {
            prediction,
            points,
            fit,
            twist: prediction.twist,
            covariance,
            alone: None,
            is_rescued: false,
            is_fused: false,
            is_predicted: false,
            searched: None,
            alternative: None,
            is_open: false,
        }
    }
}
