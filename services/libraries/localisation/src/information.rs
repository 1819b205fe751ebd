//! What is known of a pose: its information, as it is driven on, and how wide its covariance is.

use flockslam_geometry::elementary::hypot;
use flockslam_pose_graph::{Symmetric, inverse};

/// Information after errors of these variances were added: of the position, m², and of the heading, rad².
pub(crate) fn carried(information: &Symmetric, position: f64, heading: f64) -> Symmetric {
    let Some(mut covariance) = inverse(information) else { return *information };
    covariance[0] += position;
    covariance[3] += position;
    covariance[5] += heading;
    inverse(&covariance).unwrap_or(*information)
}

/// The variance of the position in its widest direction, m².
pub(crate) fn widest(covariance: &Symmetric) -> f64 {
    let [xx, xy, _, yy, ..] = *covariance;
    0.5 * (xx + yy) + hypot(0.5 * (xx - yy), xy)
}
