//! How well a constant velocity predicts a robot without odometry, learned from the scans that hold it.

use flockslam_geometry::Pose;
use flockslam_geometry::elementary::hypot;

/// Standard deviation at the start along each axis, metres from scan to scan, and its weight in scans.
const START_SIGMA_M: f64 = 0.15;
const START_SCANS: f64 = 20.0;
/// The mean is over so many scans at most: how a robot is driven changes within minutes.
const SCANS_MAX: f64 = 200.0;
/// A robot that moves less between two scans stands: it shows nothing of how velocities change, metres.
const MOVES_M: f64 = 0.02;
/// Standard deviations in units of the errors found. Velocities change seldom and then by much: with 1 their changes would be taken for
/// errors of fits.
const MARGIN: f64 = 2.0;
/// The standard deviation is within these bounds, metres.
const SIGMA_M: (f64, f64) = (0.03, 0.3);

/// The mean square of what fits corrected, as kiss-icp learns its threshold from them (Vizzo et al. 2023).
#[derive(Clone, Copy, Debug)]
pub(crate) struct VelocityNoise {
    variance_m2: f64,
    scans: f64,
}

impl Default for VelocityNoise {
    fn default() -> Self {
        let sigma_m = START_SIGMA_M / MARGIN;
        Self { variance_m2: sigma_m * sigma_m, scans: START_SCANS }
    }
}

impl VelocityNoise {
    /// Standard deviation of the position along each axis that one step adds, metres.
    pub(crate) fn sigma_m(&self) -> f64 {
        (MARGIN * self.variance_m2.sqrt()).clamp(SIGMA_M.0, SIGMA_M.1)
    }

    /// Takes in a scan that surfaces hold in all directions: the pose before it, the predicted one and the fit.
    pub(crate) fn learn(&mut self, before: Pose, predicted: Pose, fit: Pose) {
        if before.distance_m(fit) < MOVES_M {
            return;
        }
        self.scans = (self.scans + 1.0).min(SCANS_MAX);
        let missed_m = hypot(fit.x_m - predicted.x_m, fit.y_m - predicted.y_m);
        self.variance_m2 += (missed_m * missed_m - self.variance_m2) / self.scans;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_goes_on_evenly_is_predicted_better_than_one_that_does_not() {
        let mut noise = VelocityNoise::default();
        assert!((noise.sigma_m() - START_SIGMA_M).abs() < 1e-12);
        let before = Pose::IDENTITY;
        for _ in 0..1000 {
            noise.learn(before, Pose::new(0.1, 0.0, 0.0), Pose::new(0.12, 0.0, 0.0));
        }
        assert!((noise.sigma_m() - MARGIN * 0.02).abs() < 1e-3, "{noise:?}");
        for _ in 0..1000 {
            noise.learn(before, Pose::new(0.1, 0.0, 0.0), Pose::new(0.1, 0.06, 0.0));
        }
        assert!((noise.sigma_m() - MARGIN * 0.06).abs() < 1e-2, "{noise:?}");
    }

    #[test]
    fn a_robot_that_stands_teaches_nothing() {
        let mut noise = VelocityNoise::default();
        noise.learn(Pose::IDENTITY, Pose::IDENTITY, Pose::new(0.001, 0.0, 0.0));
        assert_eq!(noise.sigma_m(), START_SIGMA_M);
    }
}
