//! Gauss–Newton on interpolated scores, from coarse to fine. Takes points, a field and a predicted pose, gives the
//! fitted pose with its score and covariance.

use crate::batch::NormalEquations;
use crate::field::{ScoreField, ScoreRead};
use flockslam_evidence::Level;
use flockslam_geometry::elementary::hypot;
use flockslam_geometry::{Covariance, Point, Pose, wrap_angle};
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

/// Longest step of one iteration, metres: a nearly singular system must not throw a scan far away.
const STEP_MAX_M: f64 = 0.5;
/// Greatest turn of one iteration, radians: a point at 10 m moves by 2 m then, farther than scores reach.
const TURN_MAX_RAD: f64 = 0.2;
/// Pull towards the prediction's position, per m² and point: small, so that it decides only where the scan does not.
pub(crate) const PRIOR_XY: f64 = 0.5;
/// Pull towards the prediction's heading, per rad² and point: weak for the same reason.
pub(crate) const PRIOR_HEADING: f64 = 0.1;

/// Gauss–Newton on the score of a field.
///
/// ```
/// # use flockslam_evidence::{TILE_CELLS, Tile, TileGrid, TileKey};
/// # use flockslam_geometry::{Point, Pose};
/// use flockslam_registration::{GaussNewton, GridField};
///
/// // A room in one tile: scores fall off with the distance to the nearest wall.
/// let mut grid = TileGrid::<Box<Tile>>::new(0.05);
/// let (key, mut tile) = (TileKey { x: 0, y: 0 }, Tile::unknown(0));
/// for offset in 0..TILE_CELLS {
///     let at = grid.center(key.cell(offset));
///     let walls = [at.x_m - 0.42, at.x_m - 2.83, at.y_m - 0.37, at.y_m - 2.56];
///     let nearest_m = walls.iter().map(|off| off.abs()).fold(f64::INFINITY, f64::min);
///     tile.set_score(offset, (65_535.0 * (-0.5 * (nearest_m / 0.06).powi(2)).exp()) as u16);
/// }
/// grid.set(key, tile).unwrap();
///
/// // Points on the walls, as a robot at `truth` sees them.
/// let truth = Pose::new(1.5, 1.4, 0.3);
/// # let on_walls = (0..=40).map(|i| f64::from(i) / 40.0).flat_map(|share| {
/// #     let (x, y) = (0.42 + 2.41 * share, 0.37 + 2.19 * share);
/// #     [(x, 0.37), (x, 2.56), (0.42, y), (2.83, y)].map(|(x, y)| Point::new(x, y))
/// # });
/// let points: Vec<Point> = on_walls.map(|point| truth.inverse().apply(point)).collect();
///
/// let prediction = Pose::new(1.55, 1.36, 0.32);
/// let fit = GaussNewton::default().fit(&GridField::new(&grid, 0.0), &points, prediction, prediction);
/// assert!(fit.pose.distance_m(truth) < 0.02 && fit.pose.turn_rad(truth) < 0.01);
/// assert!(fit.score > 0.9);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct GaussNewton {
    /// Iterations on cells four times, twice and once as wide as the grid's.
    pub iterations: [u32; 3],
}

impl Default for GaussNewton {
    fn default() -> Self {
        // A bound on the work: the coarse levels only bring a pose near, and a level that has converged ends before.
        Self { iterations: [4, 4, 6] }
    }
}

/// A scan fitted to a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Frame of the field from the frame of the points.
    pub pose: Pose,
    /// Mean score of the points, 0 … 1.
    pub score: f64,
    /// Jᵀ J summed over the points (per m², per m·rad, per rad²).
    pub information: Matrix3<f64>,
    /// Mean squared residual of the points.
    pub noise: f64,
    /// Number of points.
    pub points: usize,
}

/// Below this step, in sides of its cells and in radians, a level has converged.
const STEP_MIN_CELLS: f64 = 2e-3;
const TURN_MIN_RAD: f64 = 2e-5;

/// Points that end in the same cell share the error of the map there, so a scan has less information than its number of points
/// says: the variance is this much greater (measured: mean NEES of 3 in simulated rooms, see `consistency.rs`).
const SHARED_ERROR: f64 = 1.9;

/// Variance of a point's residual as it counts in a fit, from the mean squared residual.
pub(crate) fn shared_variance(noise: f64) -> f64 {
    SHARED_ERROR * noise.max(1e-6)
}

impl GaussNewton {
    /// Fits `points` (metres, frame of the robot) to a field, from coarse to fine, starting at `start`.
    ///
    /// Minimises `Σ (1 - M(T p))² / n` plus a pull towards `prediction`, M being the field's score interpolated
    /// bilinearly. Needs at least one point.
    pub fn fit<F: ScoreField>(&self, field: &F, points: &[Point], prediction: Pose, start: Pose) -> Fit {
        let mut pose = start;
        for (level, iterations) in [Level::Quarter, Level::Half, Level::Full].into_iter().zip(self.iterations)
        {
            let mut read = field.reader(level);
            for _ in 0..iterations {
                let system = NormalEquations::of(&mut read, points, pose);
                let Some(step) = newton_step(&system, points.len(), prediction, pose) else { break };
                pose = Pose::new(pose.x_m + step.x, pose.y_m + step.y, pose.heading_rad + step.z);
                if step.xy().amax() < STEP_MIN_CELLS * read.cell_size_m() && step.z.abs() < TURN_MIN_RAD {
                    break;
                }
            }
        }
        Fit::at(field, points, pose)
    }
}

/// The next step of a pose, pulled towards the prediction and bounded in length; `None` when the system is singular.
fn newton_step(
    system: &NormalEquations,
    points: usize,
    prediction: Pose,
    pose: Pose,
) -> Option<Vector3<f64>> {
    let share = 1.0 / points as f64;
    let prior = Vector3::new(PRIOR_XY, PRIOR_XY, PRIOR_HEADING);
    let pull = Vector3::new(
        prediction.x_m - pose.x_m,
        prediction.y_m - pose.y_m,
        wrap_angle(prediction.heading_rad - pose.heading_rad),
    );
    let hessian = system.hessian * share + Matrix3::from_diagonal(&prior);
    let gradient = system.gradient * share + prior.component_mul(&pull);
    let step = hessian.cholesky()?.solve(&gradient);
    let length = hypot(step.x, step.y);
    let scale = if length > STEP_MAX_M { STEP_MAX_M / length } else { 1.0 };
    Some(Vector3::new(step.x * scale, step.y * scale, step.z.clamp(-TURN_MAX_RAD, TURN_MAX_RAD)))
}

impl Fit {
    /// Score and information of a pose, without moving it.
    pub fn at<F: ScoreField>(field: &F, points: &[Point], pose: Pose) -> Fit {
        let system = NormalEquations::of(&mut field.reader(Level::Full), points, pose);
        let share = 1.0 / points.len().max(1) as f64;
        Fit {
            pose,
            score: system.score * share,
            information: system.hessian,
            noise: system.squares * share,
            points: points.len(),
        }
    }

    /// Logarithm of the likelihood ratio of the same points here and at another pose, when the mean squared residual at the right
    /// pose is usually `noise`.
    pub fn gain_over(&self, other: &Fit, noise: f64) -> f64 {
        let squares = other.points as f64 * (other.noise - self.noise);
        0.5 * squares / shared_variance(noise)
    }

    /// Covariance of the pose, `k s² (JᵀJ)⁻¹` with s² the mean squared residual; directions that the points do not
    /// determine get the prior's standard deviations (metres, radians).
    pub fn covariance(&self, prior_xy_m: f64, prior_heading_rad: f64) -> Covariance {
        let prior = Vector3::new(prior_xy_m.powi(-2), prior_xy_m.powi(-2), prior_heading_rad.powi(-2));
        let variance = shared_variance(self.noise);
        let precision = self.information / variance + Matrix3::from_diagonal(&prior);
        let Some(factor) = precision.cholesky() else {
            return Covariance::diagonal(prior_xy_m, prior_heading_rad);
        };
        of_pose(&factor.inverse())
    }

    /// How well the worst direction of translation is determined: the smaller eigenvalue of the information on
    /// (x, y) with the heading left free, per m² and point. Small in a long corridor.
    pub fn weakest_direction(&self) -> f64 {
        let h = &self.information;
        let turn = h[(2, 2)].max(f64::MIN_POSITIVE);
        let (xx, yy) = (h[(0, 0)] - h[(0, 2)].powi(2) / turn, h[(1, 1)] - h[(1, 2)].powi(2) / turn);
        let xy = h[(0, 1)] - h[(0, 2)] * h[(1, 2)] / turn;
        let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        (mean - hypot(half, xy)).max(0.0) / self.points.max(1) as f64
    }
}

/// The covariance in a symmetric matrix whose first three rows are x, y and heading.
pub(crate) fn of_pose<const N: usize>(c: &SMatrix<f64, N, N>) -> Covariance {
    Covariance { xx: c[(0, 0)], xy: c[(0, 1)], xt: c[(0, 2)], yy: c[(1, 1)], yt: c[(1, 2)], tt: c[(2, 2)] }
}

/// `covariance` with an error of `sigma_m` of the position added in every direction.
pub fn inflated_everywhere(covariance: Covariance, sigma_m: f64) -> Covariance {
    let variance = sigma_m * sigma_m;
    Covariance { xx: covariance.xx + variance, yy: covariance.yy + variance, ..covariance }
}

/// `covariance` with an error of `sigma_m` of the position added along the unit vector `axis`.
pub fn inflated_along(covariance: Covariance, axis: Vector2<f64>, sigma_m: f64) -> Covariance {
    let variance = sigma_m * sigma_m;
    Covariance {
        xx: covariance.xx + variance * axis.x * axis.x,
        xy: covariance.xy + variance * axis.x * axis.y,
        yy: covariance.yy + variance * axis.y * axis.y,
        ..covariance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{bilinear, test_room};
    use proptest::prelude::*;

    fn solver() -> GaussNewton {
        GaussNewton { iterations: [8, 8, 12] }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn finds_the_pose_from_a_prediction_that_is_off(
            x in -1.0..2.0f64, y in -1.0..0.5f64, heading in -3.0..3.0f64,
            dx in -0.12..0.12f64, dy in -0.12..0.12f64, turn in -0.04..0.04f64
        ) {
            let grid = test_room::grid(&test_room::ROOM);
            let truth = Pose::new(x, y, heading);
            let start = Pose::new(x + dx, y + dy, heading + turn);
            let fit = solver().fit(&test_room::field(&grid), &test_room::scan(truth), start, start);
            prop_assert!(fit.pose.distance_m(truth) < 0.015 && fit.pose.turn_rad(truth) < 0.005, "{:?}", fit.pose);
            prop_assert!(fit.score > 0.8 && fit.weakest_direction() > 1.0);
            let c = fit.covariance(0.3, 0.15);
            prop_assert!(c.xx > 0.0 && c.yy > 0.0 && c.tt > 0.0 && c.xx < 0.01 && c.tt < 0.001);
        }
    }

    #[test]
    fn derivatives_are_those_of_the_score() {
        let grid = test_room::grid(&test_room::ROOM);
        let field = test_room::field(&grid);
        let mut read = crate::ScoreField::reader(&field, Level::Full);
        let step = 1e-7;
        for (x, y) in [(3.931, 0.273), (-1.957, -0.328), (0.812, 1.468)] {
            let mut value = |x: f64, y: f64| bilinear(&mut read, 20.0, x, y).value;
            let (dx, dy) =
                ((value(x + step, y) - value(x, y)) / step, (value(x, y + step) - value(x, y)) / step);
            let sample = bilinear(&mut read, 20.0, x, y);
            assert!((sample.slope_x - dx).abs() < 1e-3 && (sample.slope_y - dy).abs() < 1e-3);
        }
    }

    #[test]
    fn a_corridor_is_weak_along_itself_and_keeps_the_prediction_there() {
        let walls = [(0.0, 1.0, 1.02), (0.0, 1.0, -0.97)];
        let grid = test_room::grid(&walls);
        let points: Vec<Point> = (-60..60)
            .map(|i| f64::from(i) * 0.1)
            .flat_map(|x| [Point::new(x, 1.02), Point::new(x, -0.97)])
            .collect();
        let start = Pose::new(0.07, 0.06, 0.01);
        let fit = solver().fit(&test_room::field(&grid), &points, start, start);
        assert!(fit.weakest_direction() < 0.1, "{}", fit.weakest_direction());
        assert!(
            (fit.pose.x_m - 0.07).abs() < 0.01
                && fit.pose.y_m.abs() < 0.005
                && fit.pose.heading_rad.abs() < 0.002
        );
        let c = fit.covariance(0.3, 0.15);
        assert!(c.xx > 0.05 && c.yy < 0.001);
    }

    #[test]
    fn nothing_to_see_leaves_the_prediction() {
        let grid: flockslam_evidence::TileGrid<Box<flockslam_evidence::Tile>> =
            flockslam_evidence::TileGrid::new(0.05);
        let start = Pose::new(1.0, 2.0, 0.5);
        let fit = solver().fit(&test_room::field(&grid), &[Point::new(1.0, 0.0)], start, start);
        assert_eq!((fit.pose, fit.score), (start, 0.0));
    }
}
