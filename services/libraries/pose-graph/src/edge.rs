//! The constraint of a pose graph: a measured motion between two nodes with its information, and its error at given poses.

use crate::symmetric::{Symmetric, quadratic, times};
use flockslam_geometry::wrap_angle;
use flockslam_registration::cloud::Placement;

/// A measured motion between two nodes, which must not be the same.
///
/// ```
/// use flockslam_registration::cloud::Placement;
/// use flockslam_pose_graph::Edge;
///
/// // One metre ahead, known to 0.1 m along each axis and to 0.05 rad.
/// let information = [100.0, 0.0, 0.0, 100.0, 0.0, 400.0];
/// let edge = Edge { from: 0, to: 1, motion: Placement::new(1.0, 0.0, 0.0), information };
/// // At these poses it is off by 0.2 m: two standard deviations.
/// let poses = [Placement::IDENTITY, Placement::new(1.2, 0.0, 0.0)];
/// assert!((edge.error(&poses)[0] - 0.2).abs() < 1e-9);
/// assert!((edge.chi_squared(&poses) - 4.0).abs() < 1e-9);
/// ```
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

    /// The same measurement, from the other end.
    pub fn reversed(&self) -> Edge {
        let motion = self.motion.inverse();
        let (cos, sin) = motion.rotate(1.0, 0.0);
        // How an error of the reversed motion shows in this one, to first order.
        let columns = [
            [-cos, sin, 0.0],
            [-sin, -cos, 0.0],
            [sin * motion.x_m - cos * motion.y_m, cos * motion.x_m + sin * motion.y_m, -1.0],
        ];
        let product = |a: usize, b: usize| {
            let weighted = times(&self.information, &columns[b]);
            (0..3).map(|k| columns[a][k] * weighted[k]).sum()
        };
        let information =
            [product(0, 0), product(0, 1), product(0, 2), product(1, 1), product(1, 2), product(2, 2)];
        Edge { from: self.to, to: self.from, motion, information }
    }

    /// Squared Mahalanobis length of the error.
    pub fn chi_squared(&self, poses: &[Placement]) -> f64 {
        quadratic(&self.information, &self.error(poses))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reversed_edge_weighs_small_errors_the_same() {
        let edge = Edge {
            from: 0,
            to: 1,
            motion: Placement::new(3.0, -2.0, 0.8),
            information: [500.0, 40.0, -30.0, 300.0, 60.0, 4000.0],
        };
        for error in [(1e-4, 0.0, 0.0), (0.0, 2e-4, 0.0), (0.0, 0.0, 1e-4), (1e-4, -2e-4, 1e-4)] {
            let off = Placement::new(3.0 + error.0, -2.0 + error.1, 0.8 + error.2);
            let at = Placement::new(5.0, 7.0, -2.0);
            let poses = [at, at.compose(off)];
            let (there, back) = (edge.chi_squared(&poses), edge.reversed().chi_squared(&poses));
            assert!((there - back).abs() < 2e-3 * there, "{there} {back}");
        }
        let twice = edge.reversed().reversed();
        assert!(twice.information.iter().zip(edge.information).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}
