//! How well odometry and the velocity so far predict the velocity during the next scan, learned from the scans that were fitted.

use flockslam_geometry::Twist;

/// Means are over so many scans: at least before they are used, and at most.
const SCANS: (f64, f64) = (30.0, 200.0);
/// A single error counts as so many times the mean square at most: one slip of a wheel is no noise.
const SQUARE_MAX: f64 = 9.0;
/// Both errors contain the noise of the fits that show them. Odometry is taken as it is until its mean square is so many times that of the
/// velocity so far.
const CLEARLY: f64 = 1.5;
/// Mean squares below this are none, (m/s)² or (rad/s)²: far below what a fit shows.
const SQUARE_MIN: f64 = 1e-8;

/// Mean squared errors of both predictions: forward, leftward and of the turn, in (m/s)² and (rad/s)².
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TwistWeights {
    by_odometry: [f64; 3],
    by_velocity: [f64; 3],
    scans: f64,
}

fn components(twist: Twist) -> [f64; 3] {
    [twist.x_m_s, twist.y_m_s, twist.turn_rad_s]
}

impl TwistWeights {
    /// The velocity during the next scan, from what odometry gives and the velocity so far. Where odometry has noise from scan to scan, as
    /// much as the velocity predicts better counts for the velocity.
    pub(crate) fn blended(&self, by_odometry: Twist, so_far: Twist) -> Twist {
        if self.scans < SCANS.0 {
            return by_odometry;
        }
        let (odometry, velocity) = (components(by_odometry), components(so_far));
        let blended = |axis: usize| odometry[axis] + self.share(axis) * (velocity[axis] - odometry[axis]);
        Twist { x_m_s: blended(0), y_m_s: blended(1), turn_rad_s: blended(2) }
    }

    /// Share of the velocity so far, 0 … 1.
    fn share(&self, axis: usize) -> f64 {
        let (by_odometry, by_velocity) = (self.by_odometry[axis], self.by_velocity[axis]);
        (1.0 - CLEARLY * by_velocity / by_odometry.max(SQUARE_MIN)).max(0.0)
    }

    /// Takes in the velocity that a fit has shown, beside the two predictions of it.
    pub(crate) fn learn(&mut self, shown: Twist, by_odometry: Twist, so_far: Twist) {
        self.scans = (self.scans + 1.0).min(SCANS.1);
        let shown = components(shown);
        let means = [(&mut self.by_odometry, by_odometry), (&mut self.by_velocity, so_far)];
        for (mean, predicted) in means {
            for ((mean, shown), predicted) in mean.iter_mut().zip(shown).zip(components(predicted)) {
                let square = (shown - predicted) * (shown - predicted);
                let is_first = self.scans <= SCANS.0;
                let counted = if is_first { square } else { square.min(SQUARE_MAX * mean.max(SQUARE_MIN)) };
                *mean += (counted - *mean) / self.scans;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is learned of a robot that speeds up and slows down evenly, from fits without noise, by odometry with so much noise.
    fn learned(noise: f64) -> TwistWeights {
        let mut weights = TwistWeights::default();
        let velocity = |k: u32| Twist { x_m_s: 0.5 + 0.2 * f64::from(k % 20) / 20.0, ..Twist::default() };
        for k in 1..400 {
            let off = noise * [1.0, -1.0, -1.0, 1.0, 1.0, -1.0][k as usize % 6];
            let Twist { x_m_s, .. } = velocity(k);
            let by_odometry = Twist { x_m_s: x_m_s + off, y_m_s: off, turn_rad_s: off };
            weights.learn(velocity(k), by_odometry, velocity(k - 1));
        }
        weights
    }

    #[test]
    fn exact_odometry_is_taken_as_it_is_and_noise_gives_way_to_the_velocity() {
        let (odometry, velocity) = (
            Twist { x_m_s: 1.0, y_m_s: 0.2, turn_rad_s: 0.3 },
            Twist { x_m_s: 0.6, y_m_s: 0.0, turn_rad_s: 0.0 },
        );
        assert_eq!(learned(0.0).blended(odometry, velocity).x_m_s, 1.0);
        let blended = learned(0.3).blended(odometry, velocity);
        assert!(blended.x_m_s < 0.65 && blended.y_m_s < 0.01 && blended.turn_rad_s < 0.01, "{blended:?}");
    }

    #[test]
    fn nothing_changes_before_enough_scans_were_fitted() {
        let mut weights = TwistWeights::default();
        let off = Twist { x_m_s: 1.0, ..Twist::default() };
        for _ in 0..29 {
            weights.learn(Twist::default(), off, Twist::default());
        }
        assert_eq!(weights.blended(off, Twist::default()), off);
        weights.learn(Twist::default(), off, Twist::default());
        assert_eq!(weights.blended(off, Twist::default()), Twist::default());
    }
}
