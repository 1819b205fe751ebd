//! The scale of odometry along the robot's heading, learned from how far ahead of it the surfaces around hold scans.

/// Standard deviation of the scale before anything is learned: the radius of a wheel is known to a fiftieth.
const START_SIGMA: f64 = 0.02;
/// The scale is at most so far from 1.
const CORRECTION_MAX: f64 = 0.05;
/// An error of the scale adds up over this much travel, metres, before the surfaces around hold scans against it.
const LAG_M: f64 = 4.0;
/// Standard deviation of where surfaces hold scans ahead of odometry, apart from the scale, metres, over a metre of travel.
const AHEAD_SIGMA_M: f64 = 0.15;
/// A single scan is held at most this far ahead, metres.
const AHEAD_MAX_M: f64 = 0.3;

/// The learned scale.
///
/// In the open few points hold a scan and odometry weighs much. Its random errors average out over the way, an error of its scale does
/// not: surfaces hold all scans a little ahead of odometry, or behind it. Closed loops do not show it either. The scale is the state
/// of a Kalman filter without process noise.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WheelScale {
    correction: f64,
    information: f64,
}

impl Default for WheelScale {
    fn default() -> Self {
        Self { correction: 0.0, information: START_SIGMA.powi(-2) }
    }
}

impl WheelScale {
    /// Times the distance that odometry gives.
    pub(crate) fn factor(&self) -> f64 {
        1.0 + self.correction
    }

    /// After `travel_m` along its heading (metres, negative backwards) surfaces hold the robot `ahead_m` ahead of odometry.
    pub(crate) fn learn(&mut self, travel_m: f64, ahead_m: f64) {
        // A measurement of LAG_M times the error of the scale, made once on each metre.
        let per_m = LAG_M / (AHEAD_SIGMA_M * AHEAD_SIGMA_M);
        self.information += per_m * travel_m.abs();
        let ahead_m = ahead_m.clamp(-AHEAD_MAX_M, AHEAD_MAX_M);
        let step = per_m * travel_m * ahead_m / (LAG_M * self.information);
        self.correction = (self.correction + step).clamp(-CORRECTION_MAX, CORRECTION_MAX);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheels_that_are_a_hundredth_small_are_found_out_by_surfaces_that_follow_half() {
        let mut scale = WheelScale::default();
        let mut ahead_m = 0.0;
        for k in 0..2000 {
            // Wheels claim 1.01 times the way. Surfaces pull each scan back to where it was, a little.
            let travel_m: f64 = if k % 10 == 9 { -0.2 } else { 0.2 };
            let error_m = travel_m * (1.01 * scale.factor() - 1.0);
            ahead_m = 0.95 * (ahead_m - error_m);
            scale.learn(travel_m, ahead_m);
        }
        assert!((scale.factor() * 1.01 - 1.0).abs() < 2e-3, "{scale:?}");
    }

    #[test]
    fn a_robot_that_stands_teaches_nothing() {
        let mut scale = WheelScale::default();
        scale.learn(0.0, 0.3);
        assert_eq!(scale.factor(), 1.0);
    }
}
