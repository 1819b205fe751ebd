//! Cost, gradient and Hessian of a pose in point-to-distribution matching, and Newton's step from them.

use super::Expected;
use flockslam_geometry::{Pose, wrap_angle};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Smallest eigenvalue of the Hessian, share of the largest, below which it is lifted.
const EIGENVALUE_MIN: f64 = 1e-3;
/// Longest step, metres and (scaled) radians.
const STEP_MAX: f64 = 0.3;
/// Pull towards the prediction's position, per m² and point: it decides only where the scan does not.
const PRIOR_XY: f64 = 0.1;
/// Pull towards the prediction's heading, per rad² and point, for the same reason.
const PRIOR_HEADING: f64 = 0.02;
/// A shorter displacement has no direction, metres.
const TRAVEL_MIN_M: f64 = 0.05;

/// Cost of a pose with gradient and Hessian, divided by the number of points and grids.
pub(super) struct Terms {
    pub(super) cost: f64,
    pub(super) gradient: Vector3<f64>,
    pub(super) hessian: Matrix3<f64>,
    pub(super) hits: usize,
}

impl Terms {
    /// Adds the cost of a pose that differs from the predicted one.
    pub(super) fn pull(&mut self, prediction: Pose, pose: Pose) {
        let missed = Vector3::new(
            pose.x_m - prediction.x_m,
            pose.y_m - prediction.y_m,
            wrap_angle(pose.heading_rad - prediction.heading_rad),
        );
        let prior = Vector3::new(PRIOR_XY, PRIOR_XY, PRIOR_HEADING);
        let pulled = prior.component_mul(&missed);
        self.cost += 0.5 * pulled.dot(&missed);
        self.gradient += pulled;
        self.hessian += Matrix3::from_diagonal(&prior);
    }

    /// Adds the cost of a pose whose distance from the one before is not the expected one; `weight` per m² and point.
    pub(super) fn pull_to_distance(&mut self, weight: f64, expected: Expected, pose: Pose) {
        let Expected { pose: prediction, from } = expected;
        let Some(from) = from else { return };
        let (travelled, expected_m) =
            (pose.position().distance_m(from), prediction.position().distance_m(from));
        if travelled < TRAVEL_MIN_M || expected_m < TRAVEL_MIN_M {
            return;
        }
        let along = Vector3::new(pose.x_m - from.x_m, pose.y_m - from.y_m, 0.0) / travelled;
        let too_far = travelled - expected_m;
        self.cost += 0.5 * weight * too_far * too_far;
        self.gradient += along * (weight * too_far);
        self.hessian += along * along.transpose() * weight;
    }
}

/// Adds the contribution of one point and one cell: `turned` is the point turned into the field's axes, `weighted` is S⁻¹q.
#[inline]
pub(super) fn add_derivatives(
    gradient: &mut Vector3<f64>,
    hessian: &mut Matrix3<f64>,
    turned: Vector2<f64>,
    weighted: Vector2<f64>,
    inverse: &Matrix2<f64>,
    likelihood: f64,
) {
    let turning = Vector2::new(-turned.y, turned.x);
    let slopes = Vector3::new(weighted.x, weighted.y, weighted.dot(&turning));
    let across = inverse * turning;
    let mut curvature = Matrix3::new(
        inverse[(0, 0)],
        inverse[(0, 1)],
        across.x,
        inverse[(1, 0)],
        inverse[(1, 1)],
        across.y,
        across.x,
        across.y,
        // d²q/dφ² is the turned point, reversed.
        turning.dot(&across) - weighted.dot(&turned),
    );
    curvature -= slopes * slopes.transpose();
    *gradient += slopes * likelihood;
    *hessian += curvature * likelihood;
}

/// Newton's step with the Hessian lifted until it is safely positive, bounded in length.
pub(super) fn newton_step(terms: &Terms, scale: Vector3<f64>) -> Option<Vector3<f64>> {
    let scaling = Matrix3::from_diagonal(&scale);
    let mut hessian = scaling * terms.hessian * scaling;
    let eigenvalues = hessian.symmetric_eigenvalues();
    let (least, most) = (eigenvalues.min(), eigenvalues.abs().max());
    if least < EIGENVALUE_MIN * most {
        hessian += Matrix3::identity() * (EIGENVALUE_MIN * most - least);
    }
    let step = -hessian.cholesky()?.solve(&scale.component_mul(&terms.gradient));
    let length = step.norm();
    let bounded = if length > STEP_MAX { step * (STEP_MAX / length) } else { step };
    Some(scale.component_mul(&bounded))
}
