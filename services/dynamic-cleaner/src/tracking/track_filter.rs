//! The constant-velocity Kalman filter of one track (Bar-Shalom, Li and Kirubarajan 2001).

use flockslam_geometry::Point;
use flockslam_geometry::elementary::ln;

/// Standard deviation of a sighting, metres: bodies are seen from one side, in few beams.
const SIGHTING_SIGMA_M: f64 = 0.06;
/// Standard deviation of the velocity of a new track, m/s.
const FIRST_SPEED_SIGMA_M_S: f64 = 1.0;
/// Power density of the white acceleration by which people change their velocity, m²/s³.
const ACCELERATION_DENSITY: f64 = 0.5;

/// A Kalman filter for position and velocity (Bar-Shalom, Li and Kirubarajan 2001, section 6.2: constant velocity, white
/// acceleration). Both axes are alike, so one 2 × 2 covariance serves them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    pub position: Point,
    pub velocity: Point,
    /// Variances of position and velocity of each axis, and their covariance.
    pub pp: f64,
    pub pv: f64,
    pub vv: f64,
}

impl Motion {
    /// A new track at a place.
    pub fn at(position: Point) -> Self {
        let (pp, vv) = (SIGHTING_SIGMA_M * SIGHTING_SIGMA_M, FIRST_SPEED_SIGMA_M_S * FIRST_SPEED_SIGMA_M_S);
        Self { position, velocity: Point::default(), pp, pv: 0.0, vv }
    }

    /// The place after some seconds of the same velocity.
    pub fn position_after(&self, seconds: f64) -> Point {
        Point::new(
            self.position.x_m + seconds * self.velocity.x_m,
            self.position.y_m + seconds * self.velocity.y_m,
        )
    }

    /// Goes on by some seconds.
    pub fn predict(&mut self, seconds: f64) {
        let (t, q) = (seconds, ACCELERATION_DENSITY);
        self.position = self.position_after(t);
        self.pp += 2.0 * t * self.pv + t * t * self.vv + q * t * t * t / 3.0;
        self.pv += t * self.vv + q * t * t / 2.0;
        self.vv += q * t;
    }

    /// Squared Mahalanobis distance of a sighting.
    pub fn squared_distance(&self, sighting: Point) -> f64 {
        self.position.distance_m(sighting).powi(2) / self.innovation_variance()
    }

    /// How unlikely a sighting is: twice the negative logarithm of its density, but for a constant (Bar-Shalom, Li and Kirubarajan 2001,
    /// section 1.4). A hidden person could be anywhere, and so explains each place less well than a visible one.
    pub fn surprise(&self, sighting: Point) -> f64 {
        self.squared_distance(sighting) + 2.0 * ln(self.innovation_variance())
    }

    /// Takes a sighting in.
    pub fn correct(&mut self, sighting: Point) {
        let variance = self.innovation_variance();
        let (gain_p, gain_v) = (self.pp / variance, self.pv / variance);
        let (dx, dy) = (sighting.x_m - self.position.x_m, sighting.y_m - self.position.y_m);
        self.position = Point::new(self.position.x_m + gain_p * dx, self.position.y_m + gain_p * dy);
        self.velocity = Point::new(self.velocity.x_m + gain_v * dx, self.velocity.y_m + gain_v * dy);
        self.vv -= gain_v * self.pv;
        self.pv -= gain_p * self.pv;
        self.pp -= gain_p * self.pp;
    }

    fn innovation_variance(&self) -> f64 {
        self.pp + SIGHTING_SIGMA_M * SIGHTING_SIGMA_M
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_covariance_stays_one(steps in prop::collection::vec((0.01..1.5f64, any::<bool>()), 1..100)) {
            let mut motion = Motion::at(Point::default());
            for (seconds, seen) in steps {
                motion.predict(seconds);
                if seen {
                    motion.correct(Point::new(1.0, -1.0));
                }
                prop_assert!(motion.pp > 0.0 && motion.vv > 0.0);
                prop_assert!(motion.pv * motion.pv < motion.pp * motion.vv);
            }
        }
    }

    #[test]
    fn a_steady_walk_is_learnt_and_continued() {
        let mut motion = Motion::at(Point::default());
        for i in 1..=20 {
            motion.predict(0.1);
            motion.correct(Point::new(0.12 * f64::from(i), -0.05 * f64::from(i)));
        }
        assert!((motion.velocity.x_m - 1.2).abs() < 0.02 && (motion.velocity.y_m + 0.5).abs() < 0.02);
        assert!(motion.position_after(1.0).distance_m(Point::new(3.6, -1.5)) < 0.03);
        assert!(motion.squared_distance(Point::new(2.4, -1.0)) < 0.1);
    }
}
