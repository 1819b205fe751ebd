use crate::symmetric::{Symmetric, quadratic};
use flockslam_geometry::wrap_angle;
use flockslam_registration::cloud::Placement;

/// A measured motion between two nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Node that it starts from.
    pub from: usize,
    /// Node that it leads to.
    pub to: usize,
    /// Pose of `to` seen from `from`.
    pub motion: Placement,
    /// Information (inverse covariance) of the motion, in the axes of `from`.
    pub information: Symmetric,
}

impl Edge {
    /// Difference between the nodes' motion and the measured one: metres, metres, radians.
    pub fn error(&self, poses: &[Placement]) -> [f64; 3] {
        let seen = poses[self.from].to(poses[self.to]);
        [
            seen.x_m - self.motion.x_m,
            seen.y_m - self.motion.y_m,
            wrap_angle(seen.heading_rad - self.motion.heading_rad),
        ]
    }

    /// Squared Mahalanobis length of the error.
    pub fn chi_squared(&self, poses: &[Placement]) -> f64 {
        quadratic(&self.information, &self.error(poses))
    }
}
