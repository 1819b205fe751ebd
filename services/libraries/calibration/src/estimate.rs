//! What was learned of a lidar, and how well each part of it is known.

use flockslam_geometry::Pose;
use nalgebra::SMatrix;

/// Numbers that are estimated of a lidar: x, y, heading and the offset in time.
pub const PARAMETERS: usize = 4;
/// Standard deviations up to which a number counts as known: metres, radians, seconds. A mounting that was measured with a ruler is no better.
const KNOWN: [f64; PARAMETERS] = [0.01, 0.01, 0.0087, 0.01];

/// Where a lidar sits and how far its stamps are off, with their covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarEstimate {
    /// `base_from_laser`.
    pub base_from_laser: Pose,
    /// What is added to the stamp of a scan to have its time by the clock of odometry, seconds.
    pub offset_s: f64,
    /// Of x and y (metres), heading (radians) and offset (seconds). A number that the drive does not show has a wide one.
    pub covariance: SMatrix<f64, PARAMETERS, PARAMETERS>,
    /// Motions between two scans that it rests on.
    pub motions: usize,
}

/// Why there is no estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CalibrationError {
    /// The robot hardly moved, or had no odometry, or its scans did not fit.
    #[error("too little driving with odometry and fitted scans")]
    TooFewMotions,
    /// No estimate explains the motions.
    #[error("no mounting explains the motions of scans and odometry")]
    NotSettled,
}

impl LidarEstimate {
    /// Standard deviations of x and y (metres), heading (radians) and offset (seconds).
    pub fn deviations(&self) -> [f64; PARAMETERS] {
        std::array::from_fn(|at| self.covariance[(at, at)].max(0.0).sqrt())
    }

    /// Which of x, y, heading and offset the drive shows well enough to be used.
    pub fn is_known(&self) -> [bool; PARAMETERS] {
        let deviations = self.deviations();
        std::array::from_fn(|at| deviations[at] <= KNOWN[at])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_with_a_wide_covariance_is_not_known() {
        let deviations = [0.002, 0.5, 0.001, 0.02];
        let estimate = LidarEstimate {
            base_from_laser: Pose::IDENTITY,
            offset_s: 0.0,
            covariance: SMatrix::from_diagonal(&deviations.map(|d| d * d).into()),
            motions: 100,
        };
        assert_eq!(estimate.is_known(), [true, false, true, false]);
        assert_eq!(estimate.deviations(), deviations);
    }
}
