//! Where a lidar sits on a robot, by the motions of its scans beside those of odometry (hand-eye calibration in the plane), and the offset
//! between their clocks.
//!
//! As in A. Censi et al., *Simultaneous calibration of odometry and sensor parameters for mobile robots* (2013), what odometry has wrong is
//! estimated beside: a scale of its ways, one of its turns, and a drift of the heading by the way. Here all of it is one robust least-squares
//! problem over pairs of scans, and the offset in time is part of it.

use crate::drive_samples::{DriveSample, DriveSamples};
use crate::estimate::{CalibrationError, LidarEstimate, PARAMETERS};
use flockslam_geometry::elementary::{hypot, sin_cos};
use flockslam_geometry::{Pose, wrap_angle};
use nalgebra::{SMatrix, SVector};

/// x, y, heading, offset; scales of odometry's ways and turns, and its drift of the heading, radians per metre.
const UNKNOWNS: usize = PARAMETERS + 3;
/// Place of the offset among them.
const OFFSET: usize = 3;
/// What is known before: as wide as anything that people build, so that only what a drive does not show stays at it.
const PRIOR: [f64; UNKNOWNS] = [1.0, 1.0, 1.0, 0.3, 0.1, 0.1, 0.1];
/// Two scans are compared when they are so far apart in time, nanoseconds: over less the noise of fits hides the motion, over more odometry
/// drifts.
const APART_NS: std::ops::RangeInclusive<i64> = 800_000_000..=2_500_000_000;
/// Smaller motions are not used, metres and radians.
const MOTION_MIN: (f64, f64) = (0.03, 0.03);
/// Pairs that are used; of more, evenly spread ones.
const PAIRS_MAX: usize = 6000;
/// Fewer pairs are no drive.
const PAIRS_MIN: usize = 40;
/// Pairs within this time share their errors, nanoseconds.
const BLOCK_NS: i64 = 5_000_000_000;
/// Residuals that are this many deviations wide have half the weight (Cauchy).
const WIDE: f64 = 2.5;
/// Least deviations of a motion by fits, metres and radians.
const SIGMA_MIN: (f64, f64) = (5e-4, 2e-4);
/// The median of the absolute of a normal distribution, as a share of its deviation.
const MEDIAN_OF_NORMAL: f64 = 0.6745;
const STEPS_MAX: usize = 40;
/// So many steps come before the deviations have settled; they do with every fourth pair.
const FIRST_STEPS: usize = 5;
const FIRST_EVERY: usize = 4;
/// Steps of the numerical derivatives.
const NUDGE: [f64; UNKNOWNS] = [1e-4, 1e-4, 1e-4, 2e-3, 1e-4, 1e-4, 1e-4];

type Unknowns = SVector<f64, UNKNOWNS>;
type Information = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
type Rows = SMatrix<f64, 3, UNKNOWNS>;

/// Two scans, and how the lidar moved from one to the other by their fits.
#[derive(Clone, Copy, Debug)]
struct Pair {
    from_ns: i64,
    to_ns: i64,
    motion: Pose,
}

/// Estimates where the lidar sits, and its offset in time. `assumed` is where it was taken to sit when the scans were fitted: what their
/// poses tell is the motion of the lidar, whatever was assumed.
///
/// # Errors
/// When there is too little motion with odometry and fits, or nothing explains it.
///
/// ```
/// use flockslam_calibration::{DriveSample, DriveSamples, estimate};
/// use flockslam_geometry::{Pose, Twist};
///
/// // The lidar is mounted 0.2 m ahead, which is not configured.
/// let mounted = Pose::new(0.2, 0.0, 0.0);
/// let (mut samples, mut odometry) = (DriveSamples::default(), Pose::IDENTITY);
/// for k in 0..1000 {
///     let turn_rad_s = (0.05 * f64::from(k)).sin();
///     odometry = odometry * Twist { x_m_s: 0.5, turn_rad_s, ..Twist::default() }.motion_after(0.1);
///     let world_from_base = Some(odometry * mounted);
///     samples.push(DriveSample { stamp_ns: i64::from(k) * 100_000_000, world_from_base, odometry, trajectory: 0 });
/// }
/// let found = estimate(&samples, Pose::IDENTITY)?;
/// assert!(found.base_from_laser.distance_m(mounted) < 1e-3);
/// assert!(found.is_known()[0]);
/// # Ok::<(), flockslam_calibration::CalibrationError>(())
/// ```
pub fn estimate(samples: &DriveSamples, assumed: Pose) -> Result<LidarEstimate, CalibrationError> {
    let pairs = pairs(samples, assumed);
    if pairs.len() < PAIRS_MIN {
        return Err(CalibrationError::TooFewMotions);
    }
    let problem = Problem { samples, pairs, assumed };
    let (mut state, mut sigma) = (Unknowns::zeros(), (0.02, 0.01));
    for step in 0..STEPS_MAX {
        let is_first = step < FIRST_STEPS && problem.pairs.len() >= FIRST_EVERY * PAIRS_MIN;
        let every = if is_first { FIRST_EVERY } else { 1 };
        let Normal { information, gradient, .. } = problem.normal(&state, sigma, every);
        let change = information.cholesky().ok_or(CalibrationError::NotSettled)?.solve(&gradient);
        state -= change;
        sigma = problem.deviations(&state, every).ok_or(CalibrationError::TooFewMotions)?;
        if step >= FIRST_STEPS && change.component_div(&Unknowns::from(NUDGE)).amax() < 1e-2 {
            return problem.conclude(&state, sigma);
        }
    }
    Err(CalibrationError::NotSettled)
}

/// Pairs of fitted scans with motion between them.
fn pairs(samples: &DriveSamples, assumed: Pose) -> Vec<Pair> {
    let fitted: Vec<(&DriveSample, Pose)> = samples
        .iter()
        .filter_map(|sample| Some((sample, sample.world_from_base.filter(|pose| pose.is_finite())?)))
        .collect();
    let mut found = Vec::new();
    let mut behind = 0;
    for (sample, pose) in &fitted {
        while fitted
            .get(behind)
            .is_some_and(|(other, _)| other.stamp_ns - sample.stamp_ns < *APART_NS.start())
        {
            behind += 1;
        }
        let Some((other, to)) = fitted.get(behind) else { break };
        let is_near = APART_NS.contains(&(other.stamp_ns - sample.stamp_ns));
        if !is_near || other.trajectory != sample.trajectory {
            continue;
        }
        let motion = (*pose * assumed).to(*to * assumed);
        let moved = sample.odometry.to(other.odometry);
        if hypot(moved.x_m, moved.y_m) > MOTION_MIN.0 || moved.heading_rad.abs() > MOTION_MIN.1 {
            found.push(Pair { from_ns: sample.stamp_ns, to_ns: other.stamp_ns, motion });
        }
    }
    let stride = found.len().div_ceil(PAIRS_MAX).max(1);
    found.into_iter().step_by(stride).collect()
}

struct Problem<'a> {
    samples: &'a DriveSamples,
    pairs: Vec<Pair>,
    assumed: Pose,
}

/// Normal equations.
struct Normal {
    /// With what was known before.
    information: Information,
    /// Of the pairs alone.
    of_pairs: Information,
    gradient: Unknowns,
    /// Sums of the gradients of pairs that share errors, squared.
    blocks: Information,
}

impl Problem<'_> {
    /// How the lidar has moved by odometry, less how it has by its fits; `None` where odometry has a gap.
    fn residual(&self, pair: &Pair, state: &Unknowns) -> Option<SVector<f64, 3>> {
        Some(self.residual_of(pair, self.moved(pair, state)?, state))
    }

    /// How the robot has moved by odometry.
    fn moved(&self, pair: &Pair, state: &Unknowns) -> Option<Pose> {
        let offset_ns = (state[OFFSET] * 1e9).round() as i64;
        let from = self.samples.odometry_at(pair.from_ns + offset_ns)?;
        let to = self.samples.odometry_at(pair.to_ns + offset_ns)?;
        Some(from.to(to))
    }

    fn residual_of(&self, pair: &Pair, moved: Pose, state: &Unknowns) -> SVector<f64, 3> {
        let [dx, dy, dh, _, ways, turns, drift] = (*state).into();
        // A turn that odometry has wrong is made on the way: half of it turns the way.
        let wrong_rad = turns * moved.heading_rad + drift * hypot(moved.x_m, moved.y_m);
        let (sin, cos) = sin_cos(0.5 * wrong_rad);
        let (x_m, y_m) = (cos * moved.x_m - sin * moved.y_m, sin * moved.x_m + cos * moved.y_m);
        let right = Pose::new((1.0 + ways) * x_m, (1.0 + ways) * y_m, moved.heading_rad + wrong_rad);
        let mounted = self.mounted(dx, dy, dh);
        let expected = mounted.to(right * mounted);
        SVector::from([
            expected.x_m - pair.motion.x_m,
            expected.y_m - pair.motion.y_m,
            wrap_angle(expected.heading_rad - pair.motion.heading_rad),
        ])
    }

    fn mounted(&self, dx: f64, dy: f64, dh: f64) -> Pose {
        let assumed = self.assumed;
        Pose::new(assumed.x_m + dx, assumed.y_m + dy, assumed.heading_rad + dh)
    }

    fn normal(&self, state: &Unknowns, (sigma_m, sigma_rad): (f64, f64), every: usize) -> Normal {
        let weights = SVector::from([1.0 / sigma_m, 1.0 / sigma_m, 1.0 / sigma_rad]);
        let (mut of_pairs, mut gradient) = (Information::zeros(), Unknowns::zeros());
        let (mut blocks, mut block, mut block_ns) = (Information::zeros(), Unknowns::zeros(), i64::MIN);
        for pair in self.pairs.iter().step_by(every) {
            let Some(moved) = self.moved(pair, state) else { continue };
            let Some(rows) = self.derivatives(pair, moved, state) else { continue };
            let residual = self.residual_of(pair, moved, state).component_mul(&weights);
            let rows = Rows::from_fn(|row, column| weights[row] * rows[(row, column)]);
            let weight = 1.0 / (1.0 + residual.norm_squared() / (WIDE * WIDE));
            let share = weight * rows.transpose() * residual;
            of_pairs += weight * rows.transpose() * rows;
            gradient += share;
            if pair.from_ns.saturating_sub(block_ns) > BLOCK_NS {
                blocks += block * block.transpose();
                (block, block_ns) = (Unknowns::zeros(), pair.from_ns);
            }
            block += share;
        }
        blocks += block * block.transpose();
        let prior = Information::from_diagonal(&Unknowns::from(PRIOR.map(|sigma| 1.0 / (sigma * sigma))));
        Normal { information: of_pairs + prior, of_pairs, gradient: gradient + prior * state, blocks }
    }

    /// `moved` is how the robot has moved: only another offset in time changes it.
    fn derivatives(&self, pair: &Pair, moved: Pose, state: &Unknowns) -> Option<Rows> {
        let mut rows = Rows::zeros();
        for (unknown, nudge) in NUDGE.into_iter().enumerate() {
            let nudged = |by: f64| {
                let mut state = *state;
                state[unknown] += by;
                let moved = if unknown == OFFSET { self.moved(pair, &state)? } else { moved };
                Some(self.residual_of(pair, moved, &state))
            };
            let slope = (nudged(nudge)? - nudged(-nudge)?) / (2.0 * nudge);
            rows.set_column(unknown, &slope);
        }
        Some(rows)
    }

    /// Deviations of the residuals, by their medians: metres and radians.
    fn deviations(&self, state: &Unknowns, every: usize) -> Option<(f64, f64)> {
        let pairs = self.pairs.iter().step_by(every);
        let residuals: Vec<_> = pairs.filter_map(|pair| self.residual(pair, state)).collect();
        let places = residuals.iter().flat_map(|residual| [residual[0].abs(), residual[1].abs()]).collect();
        let turns = residuals.iter().map(|residual| residual[2].abs()).collect();
        let (place_m, turn_rad) = (median(places)?, median(turns)?);
        Some(((place_m / MEDIAN_OF_NORMAL).max(SIGMA_MIN.0), (turn_rad / MEDIAN_OF_NORMAL).max(SIGMA_MIN.1)))
    }

    /// The estimate and its covariance: that of independent pairs, and what pairs that share errors add (H. White's sandwich, by blocks).
    fn conclude(&self, state: &Unknowns, sigma: (f64, f64)) -> Result<LidarEstimate, CalibrationError> {
        let normal = self.normal(state, sigma, 1);
        let inverse = normal.information.cholesky().ok_or(CalibrationError::NotSettled)?.inverse();
        let prior = normal.information - normal.of_pairs;
        let covariance = inverse * (normal.of_pairs + normal.blocks + prior) * inverse;
        let [dx, dy, dh, offset_s, ..]: [f64; UNKNOWNS] = (*state).into();
        Ok(LidarEstimate {
            base_from_laser: self.mounted(dx, dy, dh),
            offset_s,
            covariance: covariance.fixed_view::<PARAMETERS, PARAMETERS>(0, 0).into_owned(),
            motions: self.pairs.len(),
        })
    }
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (middle > 0).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Twist;

    /// A drive of so many seconds, ten scans a second: odometry that is a little wrong, fits that scatter.
    struct Drive {
        mounted: Pose,
        assumed: Pose,
        offset_s: f64,
        turns: bool,
        slips: bool,
    }

    /// Noise of a deviation of about 1 that needs no generator.
    fn noise(k: f64, salt: f64) -> f64 {
        let value = ((k * 12.9898 + salt * 78.233).sin() * 43_758.545_3).fract().abs();
        (value - 0.5) * 12f64.sqrt()
    }

    impl Drive {
        fn twist(&self, at_s: f64) -> Twist {
            let turn_rad_s =
                if self.turns { 0.8 * (0.7 * at_s).sin() + 0.3 * (0.31 * at_s).sin() } else { 0.0 };
            Twist { x_m_s: 0.5 + 0.3 * (0.9 * at_s).sin(), turn_rad_s, ..Twist::default() }
        }

        fn samples(&self) -> DriveSamples {
            const STEPS_PER_S: usize = 200;
            let (mut at, mut odometry) = (Pose::IDENTITY, Pose::new(3.0, -2.0, 1.0));
            let (mut truth, mut wheels) = (vec![at], vec![odometry]);
            for step in 0..125 * STEPS_PER_S {
                let seconds = 1.0 / STEPS_PER_S as f64;
                let twist = self.twist(step as f64 * seconds);
                at = at * twist.motion_after(seconds);
                let slip = if self.slips && step % 4000 < 100 { 1.5 } else { 1.0 };
                let measured = Twist {
                    x_m_s: slip * 1.02 * twist.x_m_s,
                    turn_rad_s: 0.97 * twist.turn_rad_s + 0.01 * twist.x_m_s,
                    ..twist
                };
                odometry = odometry * measured.motion_after(seconds);
                truth.push(at);
                wheels.push(odometry);
            }
            let mut samples = DriveSamples::default();
            for scan in 0..1200 {
                let at_s = 1.0 + 0.1 * scan as f64;
                let step = |at_s: f64| (at_s * STEPS_PER_S as f64).round() as usize;
                let number = scan as f64;
                let fitted = truth[step(at_s)] * self.mounted * self.assumed.inverse();
                let scatter = Pose::new(
                    0.004 * noise(number, 1.0),
                    0.004 * noise(number, 2.0),
                    0.001 * noise(number, 3.0),
                );
                samples.push(DriveSample {
                    stamp_ns: (at_s * 1e9) as i64,
                    world_from_base: Some(fitted * scatter),
                    // A scan that is stamped too early is taken at a later time of odometry.
                    odometry: wheels[step(at_s - self.offset_s)],
                    trajectory: 0,
                });
            }
            samples
        }
    }

    fn wrong() -> Drive {
        let (mounted, assumed) = (Pose::new(0.25, 0.02, 0.1), Pose::new(0.2, 0.0, 0.1 - 0.0524));
        Drive { mounted, assumed, offset_s: 0.04, turns: true, slips: true }
    }

    #[test]
    fn a_wrong_mounting_and_an_offset_are_found_beside_odometry_that_is_wrong_too() {
        let drive = wrong();
        let found = estimate(&drive.samples(), drive.assumed).unwrap();
        let errors = [
            found.base_from_laser.x_m - drive.mounted.x_m,
            found.base_from_laser.y_m - drive.mounted.y_m,
            wrap_angle(found.base_from_laser.heading_rad - drive.mounted.heading_rad),
            found.offset_s - drive.offset_s,
        ];
        for ((error, limit), deviation) in
            errors.iter().zip([0.004, 0.004, 0.003, 0.002]).zip(found.deviations())
        {
            assert!(error.abs() < limit, "{errors:?}");
            assert!(
                error.abs() < 4.0 * deviation && deviation < limit,
                "{errors:?} {:?}",
                found.deviations()
            );
        }
        assert_eq!(found.is_known(), [true; 4]);
    }

    #[test]
    fn parameters_that_a_drive_does_not_excite_are_not_observable() {
        let straight = Drive { turns: false, slips: false, ..wrong() };
        let found = estimate(&straight.samples(), straight.assumed).unwrap();
        assert_eq!(found.is_known(), [false, false, true, true], "{:?}", found.deviations());
        assert!(found.deviations()[0] > 0.3 && found.base_from_laser.distance_m(straight.assumed) < 0.1);
        let error_rad = wrap_angle(found.base_from_laser.heading_rad - straight.mounted.heading_rad);
        assert!(error_rad.abs() < 0.003, "{error_rad}");
    }

    #[test]
    fn without_motion_or_matches_nothing_is_estimated() {
        let drive = wrong();
        let still = DriveSample { world_from_base: Some(Pose::IDENTITY), ..DriveSample::default() };
        let mut samples = DriveSamples::default();
        (0..500).for_each(|k| samples.push(DriveSample { stamp_ns: k * 100_000_000, ..still }));
        assert_eq!(estimate(&samples, Pose::IDENTITY), Err(CalibrationError::TooFewMotions));
        let mut samples = DriveSamples::default();
        drive
            .samples()
            .iter()
            .for_each(|sample| samples.push(DriveSample { world_from_base: None, ..*sample }));
        assert_eq!(estimate(&samples, drive.assumed), Err(CalibrationError::TooFewMotions));
    }
}
