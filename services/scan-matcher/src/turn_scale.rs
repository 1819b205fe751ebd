//! The scale of turns by odometry, learned from fits: what the velocity during a scan is corrected by.

/// Standard deviation of the scale before anything is learned: the distance of the wheels is known to a twentieth.
const START_SIGMA: f64 = 0.05;
/// The scale is at most so far from 1.
const CORRECTION_MAX: f64 = 0.2;
/// Standard deviation of a turn as two fits measure it, radians.
const FIT_SIGMA_RAD: f64 = 0.01;
/// Turns that fits and odometry see more differently than this, radians, are slips.
const SLIP_RAD: f64 = 0.05;
/// The share of a turn that odometry misses beyond its scale, before anything is learned, and how firmly that is assumed: as by so many
/// turns of a tenth of a radian.
const START_SHARE: f64 = 0.02;
const START_TURNS: f64 = 20.0;
const START_TURN_RAD: f64 = 0.1;

/// The learned scale of turns: the state of a Kalman filter without process noise.
///
/// Beams of a scan that leave one after the other are straightened by the velocity of turning. An error of a fiftieth bends the scan of a
/// robot that turns by 2 rad/s by a quarter of a degree.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TurnScale {
    correction: f64,
    information: f64,
    /// Sums of what turns have missed, squared, and of these turns, squared: each turn weighs by its square, since fits miss small ones too.
    missed: f64,
    turned: f64,
}

impl Default for TurnScale {
    fn default() -> Self {
        let turned = START_TURNS * START_TURN_RAD.powi(4);
        Self {
            correction: 0.0,
            information: START_SIGMA.powi(-2),
            missed: START_SHARE * START_SHARE * turned,
            turned,
        }
    }
}

impl TurnScale {
    /// Times the turn that odometry gives.
    pub(crate) fn factor(&self) -> f64 {
        1.0 + self.correction
    }

    /// Standard deviation of a turn by odometry times the factor, as a share of it. What fits themselves miss counts as missed by odometry, but
    /// never so that more is than was assumed at first.
    pub(crate) fn share(&self) -> f64 {
        let missed = (self.missed / self.turned).sqrt().min(START_SHARE);
        missed.max(self.information.sqrt().recip())
    }

    /// The robot has turned by `fitted_rad`, and by odometry `odometry_rad`.
    pub(crate) fn learn(&mut self, odometry_rad: f64, fitted_rad: f64) {
        let missed_rad = fitted_rad - self.factor() * odometry_rad;
        if missed_rad.abs() > SLIP_RAD {
            return;
        }
        let weight = odometry_rad * odometry_rad;
        self.missed += weight * missed_rad * missed_rad;
        self.turned += weight * weight;
        let per_fit = FIT_SIGMA_RAD.powi(-2);
        self.information += per_fit * odometry_rad * odometry_rad;
        let step = per_fit * odometry_rad * missed_rad / self.information;
        self.correction = (self.correction + step).clamp(-CORRECTION_MAX, CORRECTION_MAX);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheels_that_are_too_far_apart_are_found_out() {
        let mut scale = TurnScale::default();
        for k in 0..200 {
            let turn_rad = if k % 40 < 20 { 0.2 } else { -0.15 };
            scale.learn(0.97 * turn_rad, turn_rad + 0.003 * f64::from(k % 3 - 1));
        }
        assert!((0.97 * scale.factor() - 1.0).abs() < 2e-3, "{scale:?}");
    }

    #[test]
    fn turns_that_odometry_never_misses_weigh_more_and_others_never_less_than_at_first() {
        let learned = |missed_rad: f64| {
            let mut scale = TurnScale::default();
            for k in 0..300 {
                let turn_rad = if k % 40 < 20 { 0.2 } else { -0.2 };
                scale.learn(turn_rad, turn_rad + if k % 2 == 0 { missed_rad } else { -missed_rad });
            }
            scale.share()
        };
        assert_eq!(TurnScale::default().share(), START_SIGMA);
        assert!(learned(0.0005) < 0.006, "{}", learned(0.0005));
        assert!((learned(0.02) - START_SHARE).abs() < 1e-3, "{}", learned(0.02));
    }

    #[test]
    fn a_robot_that_goes_straight_and_one_that_slips_teach_nothing() {
        let mut scale = TurnScale::default();
        scale.learn(0.0, 0.01);
        scale.learn(0.1, 0.5);
        assert_eq!(scale.factor(), 1.0);
    }
}
