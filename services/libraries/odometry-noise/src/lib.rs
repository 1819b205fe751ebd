//! How far odometry may be off, and by how much fits of scans scatter: both learned from how they differ.

use flockslam_geometry::elementary::hypot;
use flockslam_geometry::{Covariance, Pose};

/// Variance of the position per metre of travel, m²/m: 0.1 m after half a metre on poor wheels.
const POSITION_PER_M: f64 = 0.02;
/// Variance of the heading per radian turned, rad²/rad, and per metre of travel, rad²/m.
const HEADING_PER_RAD: f64 = 0.01;
const HEADING_PER_M: f64 = 3e-4;
/// Measured poses are compared when they are this far apart, metres of way.
const APART_M: f64 = 0.3;
/// A turn counts as so much way, metres per radian.
const TURN_M_PER_RAD: f64 = 0.5;
/// Poses in the window: the oldest is some metres back.
const WINDOW: usize = 8;
/// A difference over a gap longer than this, metres, is not used: the fits between were no measurements.
const GAP_MAX_M: f64 = 0.8;
/// Learned scales of odometry stay within these bounds: the best wheels, and wheels with hardly any weight.
const SCALES: (f64, f64) = (0.01, 4.0);
/// Fits scatter at most this many times more than they claim, in variance.
const SCATTER_MAX: f64 = 1000.0;
/// Samples that the first guess weighs as much as, and samples over which later ones are averaged.
const SAMPLES: (f64, f64) = (5.0, 60.0);
/// A square counts at most this many times the mean so far: a slip now and then does not change it.
const SQUARE_MAX: f64 = 6.0;

/// What is learned of the errors of a robot's odometry and of the fits of its scans.
///
/// Errors of odometry add up on the way; errors of fits to a map do not. So the squared difference of both grows with the way
/// by what odometry adds, from a start that the fits' own scatter gives: `D(way) = scale · usual(way) + 2 · scatter`. Two
/// lengths of way give both.
///
/// ```
/// use flockslam_geometry::{Covariance, Pose};
/// use flockslam_odometry_noise::OdometryNoise;
///
/// let mut noise = OdometryNoise::default();
/// let (usual_m2, _) = noise.variances(1.0, 0.0);
/// // Fits that scatter by centimetres, beside wheels that are right.
/// for k in 0..200 {
///     let (x_m, off_m) = (0.3 * f64::from(k), [0.05, -0.03, 0.0, -0.05, 0.03][k as usize % 5]);
///     let claimed = Covariance::diagonal(0.01, 0.003);
///     noise.learn(Pose::new(x_m, off_m, 0.0), Pose::new(x_m, 0.0, 0.0), claimed);
/// }
/// assert!(noise.variances(1.0, 0.0).0 < 0.2 * usual_m2);
/// assert!(noise.inflated(Covariance::diagonal(0.01, 0.003)).yy > 4.0 * 0.01 * 0.01);
/// ```
#[derive(Clone, Debug)]
pub struct OdometryNoise {
    position: Learned,
    heading: Learned,
    /// The last measured poses, a ring.
    window: [Option<Measured>; WINDOW],
    newest: usize,
}

#[derive(Clone, Copy, Debug)]
struct Measured {
    pose: Pose,
    odometry: Pose,
}

/// What is learned of one kind of coordinate.
#[derive(Clone, Copy, Debug)]
struct Learned {
    /// Means of squared differences over a short and a long way, and of what usual odometry would add there.
    short: Mean,
    long: Mean,
    /// Mean of the variances that fits claim.
    claimed: f64,
}

#[derive(Clone, Copy, Debug)]
struct Mean {
    square: f64,
    usual: f64,
    samples: f64,
}

impl Default for OdometryNoise {
    fn default() -> Self {
        Self { position: Learned::new(), heading: Learned::new(), window: [None; WINDOW], newest: 0 }
    }
}

impl OdometryNoise {
    /// Variances of the error after this much travel, metres, and turning, radians: of the position along each axis, m², and of
    /// the heading, rad².
    pub fn variances(&self, travel_m: f64, turn_rad: f64) -> (f64, f64) {
        let ((position, heading), scales) = (usual(travel_m, turn_rad), self.scales());
        (scales.0 * position, scales.1 * heading)
    }

    /// The learned scales of the variances of positions and of headings: 1 for usual wheels.
    pub fn scales(&self) -> (f64, f64) {
        (self.position.scale(), self.heading.scale())
    }

    /// Times the variance of the position that fits claim: 1 where they scatter as they say.
    pub fn excess(&self) -> f64 {
        self.position.excess()
    }

    /// Times the variances of position and heading that fits claim.
    pub fn excesses(&self) -> (f64, f64) {
        (self.position.excess(), self.heading.excess())
    }

    /// The covariance of a fit, inflated by as much as fits scatter more than they claim.
    pub fn inflated(&self, covariance: Covariance) -> Covariance {
        let (position, heading) = (self.position.excess(), self.heading.excess());
        let mixed = (position * heading).sqrt();
        Covariance {
            xx: position * covariance.xx,
            xy: position * covariance.xy,
            yy: position * covariance.yy,
            xt: mixed * covariance.xt,
            yt: mixed * covariance.yt,
            tt: heading * covariance.tt,
        }
    }

    /// A scan was fitted here, with its own covariance, and odometry gave that.
    pub fn learn(&mut self, pose: Pose, odometry: Pose, claimed: Covariance) {
        let now = Measured { pose, odometry };
        if let Some(last) = self.window[self.newest] {
            let way_m =
                last.odometry.distance_m(odometry) + TURN_M_PER_RAD * last.odometry.turn_rad(odometry);
            if way_m < APART_M {
                return;
            }
            if way_m > GAP_MAX_M {
                self.window = [None; WINDOW];
            } else {
                self.position.claims(0.5 * (claimed.xx + claimed.yy));
                self.heading.claims(claimed.tt);
                self.compare(last, now, false);
            }
        }
        self.newest = (self.newest + 1) % WINDOW;
        if let Some(oldest) = self.window[self.newest].replace(now) {
            self.compare(oldest, now, true);
        }
    }

    /// Nothing connects the next fit with those before. What was learned holds.
    pub fn break_off(&mut self) {
        self.window = [None; WINDOW];
    }

    fn compare(&mut self, from: Measured, to: Measured, is_long: bool) {
        let (measured, by_odometry) = (from.pose.to(to.pose), from.odometry.to(to.odometry));
        let error = measured.to(by_odometry);
        let square = 0.5 * (error.x_m * error.x_m + error.y_m * error.y_m);
        let turned = error.heading_rad * error.heading_rad;
        let (position, heading) =
            usual(hypot(by_odometry.x_m, by_odometry.y_m), by_odometry.heading_rad.abs());
        self.position.sample(is_long, square, position);
        self.heading.sample(is_long, turned, heading);
    }
}

impl Learned {
    fn new() -> Self {
        let nothing = Mean { square: 0.0, usual: 0.0, samples: 0.0 };
        Self { short: nothing, long: nothing, claimed: 0.0 }
    }

    fn claims(&mut self, variance: f64) {
        self.claimed += (variance - self.claimed) / (self.short.samples + 1.0).min(SAMPLES.1);
    }

    fn sample(&mut self, is_long: bool, square: f64, usual: f64) {
        let mean = if is_long { &mut self.long } else { &mut self.short };
        if mean.samples == 0.0 {
            // Before anything is known, usual odometry is assumed.
            *mean = Mean { square: usual, usual, samples: SAMPLES.0 };
        }
        mean.samples += 1.0;
        let rate = 1.0 / mean.samples.min(SAMPLES.1);
        mean.square += rate * (square.min(SQUARE_MAX * mean.square.max(1e-8)) - mean.square);
        mean.usual += rate * (usual - mean.usual);
    }

    /// Times the usual variance of odometry.
    fn scale(&self) -> f64 {
        let more = self.long.usual - self.short.usual;
        if self.long.samples == 0.0 || more <= 0.0 {
            return 1.0;
        }
        ((self.long.square - self.short.square) / more).clamp(SCALES.0, SCALES.1)
    }

    /// Times the variance that fits claim.
    fn excess(&self) -> f64 {
        if self.long.samples == 0.0 || self.claimed <= 0.0 {
            return 1.0;
        }
        let scatter = 0.5 * (self.short.square - self.scale() * self.short.usual);
        (scatter / self.claimed).clamp(1.0, SCATTER_MAX)
    }
}

/// What usual odometry adds on the way: variances of the position, m², and of the heading, rad².
fn usual(travel_m: f64, turn_rad: f64) -> (f64, f64) {
    (POSITION_PER_M * travel_m, HEADING_PER_RAD * turn_rad + HEADING_PER_M * travel_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is learned on a drive of `metres` on wheels whose errors have these standard deviations over a metre, with fits that
    /// scatter so, in metres and radians, and claim a centimetre and 3 mrad.
    fn learned(metres: u32, wheels: (f64, f64), fits: (f64, f64)) -> OdometryNoise {
        let mut noise = OdometryNoise::default();
        let mut state = 1u64;
        let mut normal = || {
            let mut uniform = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 40) as f64 / (1u64 << 24) as f64
            };
            (0..12).map(|_| uniform()).sum::<f64>() - 6.0
        };
        let (mut truth, mut odometry) = (Pose::IDENTITY, Pose::IDENTITY);
        for k in 0..10 * metres {
            truth = truth * Pose::new(0.1, 0.0, 0.0);
            let root = f64::sqrt(0.1);
            let slip = if k % 500 == 7 { 0.4 } else { 0.0 };
            let [x, y] = [(); 2].map(|()| wheels.0 * root * normal());
            odometry = odometry * Pose::new(0.1 + x, y, slip + wheels.1 * root * normal());
            let fit = truth * Pose::new(fits.0 * normal(), fits.0 * normal(), fits.1 * normal());
            noise.learn(fit, odometry, Covariance::diagonal(0.01, 0.003));
        }
        noise
    }

    #[test]
    fn errors_of_wheels_and_scatter_of_fits_are_separated() {
        for (wheels, fits) in
            [((0.02, 0.005), (0.01, 0.003)), ((0.02, 0.005), (0.06, 0.01)), ((0.1, 0.015), (0.01, 0.003))]
        {
            let noise = learned(400, wheels, fits);
            let (position, heading) = noise.scales();
            let expected = (wheels.0 * wheels.0 / POSITION_PER_M, wheels.1 * wheels.1 / HEADING_PER_M);
            assert!((0.25..4.0).contains(&(position / expected.0)), "{position} for {}", expected.0);
            assert!((0.25..4.0).contains(&(heading / expected.1)), "{heading} for {}", expected.1);
            let scatter_m = noise.inflated(Covariance::diagonal(0.01, 0.003)).xx.sqrt();
            assert!((0.6..1.7).contains(&(scatter_m / fits.0)), "{scatter_m} for {}", fits.0);
        }
    }

    #[test]
    fn a_drive_that_was_not_measured_teaches_nothing() {
        let mut noise = OdometryNoise::default();
        let claimed = Covariance::diagonal(0.01, 0.003);
        noise.learn(Pose::IDENTITY, Pose::IDENTITY, claimed);
        noise.learn(Pose::new(9.0, 5.0, 1.0), Pose::new(9.0, 0.0, 0.0), claimed);
        assert_eq!((noise.scales(), noise.inflated(claimed)), ((1.0, 1.0), claimed));
    }
}
