//! Sums of occupied mass and the normal distributions made of them, with the distance of a point from one.

use super::NdtSettings;
use flockslam_geometry::Point;
use nalgebra::{Matrix2, Vector2};

/// A cell counts with at least this much occupied mass in it, grid cells: of fewer than three points (Biber and Straßer 2003)
/// no distribution can be made.
const MASS_MIN: f64 = 3.0;
/// Floor of the smaller eigenvalue of a covariance, share of the larger one (Biber and Straßer 2003): the covariance of a straight wall
/// would have no inverse.
const FLATNESS_MIN: f64 = 0.001;

/// Sums over occupied cells, relative to the centre of their block: mass, first and second moments (metres).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    mass: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Moments {
    pub(super) fn add(&mut self, mass: f64, x: f64, y: f64) {
        self.mass += mass;
        self.x += mass * x;
        self.y += mass * y;
        self.xx += mass * x * x;
        self.xy += mass * x * y;
        self.yy += mass * y * y;
    }

    /// The same sums taken about a point that is at (-dx, -dy).
    pub(super) fn shifted(self, dx: f64, dy: f64) -> Self {
        Self {
            mass: self.mass,
            x: self.x + self.mass * dx,
            y: self.y + self.mass * dy,
            xx: self.xx + 2.0 * dx * self.x + self.mass * dx * dx,
            xy: self.xy + dx * self.y + dy * self.x + self.mass * dx * dy,
            yy: self.yy + 2.0 * dy * self.y + self.mass * dy * dy,
        }
    }

    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            mass: self.mass + other.mass,
            x: self.x + other.x,
            y: self.y + other.y,
            xx: self.xx + other.xx,
            xy: self.xy + other.xy,
            yy: self.yy + other.yy,
        }
    }

    /// The normal distribution of the sums, which were taken about `center`, for `points` points that are to be compared with it:
    /// of few samples the mean is not known better than their spread allows, however many points are compared with it.
    pub(super) fn normal(
        self,
        center: Point,
        points: f64,
        settings: &NdtSettings,
        cell_m: f64,
    ) -> Option<Normal> {
        if self.mass < MASS_MIN {
            return None;
        }
        let (mx, my) = (self.x / self.mass, self.y / self.mass);
        // Each sum stands for a whole cell of the grid: its own spread belongs to the distribution.
        let spread = cell_m * cell_m / 12.0;
        let covariance = Matrix2::new(
            self.xx / self.mass - mx * mx + spread,
            self.xy / self.mass - mx * my,
            self.xy / self.mass - mx * my,
            self.yy / self.mass - my * my + spread,
        );
        let crowd = if settings.bearing_sigma_rad > 0.0 { (points / self.mass).max(1.0) } else { 1.0 };
        let eigen = (covariance * crowd).symmetric_eigen();
        let floor = FLATNESS_MIN * eigen.eigenvalues.max();
        let inverted = eigen.eigenvalues.map(|value| 1.0 / value.max(floor).max(f64::MIN_POSITIVE));
        let inverse = eigen.eigenvectors * Matrix2::from_diagonal(&inverted) * eigen.eigenvectors.transpose();
        Some(Normal { mean: Vector2::new(center.x_m + mx, center.y_m + my), inverse })
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Normal {
    pub(super) mean: Vector2<f64>,
    pub(super) inverse: Matrix2<f64>,
}

/// How far a point is from the mean, by the covariance of both.
pub(super) struct Away {
    /// Inverse covariance times the displacement.
    pub(super) weighted: Vector2<f64>,
    /// Standard deviations, squared.
    pub(super) squared: f64,
}

impl Normal {
    /// How far a point is that is `q` from the mean and blurred along `blur`, metres (one standard deviation).
    #[inline]
    pub(super) fn away(&self, q: Vector2<f64>, blur: Vector2<f64>) -> Away {
        // As in `inverse_with`, without the matrix: most points are far from most means.
        let (across, straight) = (self.inverse * blur, self.inverse * q);
        let share = blur.dot(&straight) / (1.0 + blur.dot(&across));
        let weighted = straight - across * share;
        Away { weighted, squared: q.dot(&weighted) }
    }

    /// Inverse covariance of the distance from the mean to a point that is blurred along `blur`, metres (one standard deviation).
    #[inline]
    pub(super) fn inverse_with(&self, blur: Vector2<f64>) -> Matrix2<f64> {
        // Sherman and Morrison 1950.
        let weighted = self.inverse * blur;
        self.inverse - weighted * weighted.transpose() / (1.0 + blur.dot(&weighted))
    }
}
