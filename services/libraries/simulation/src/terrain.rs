//! Uneven ground: its height, its slope, and where a beam meets it.

use flockslam_geometry::Point;
use flockslam_geometry::elementary::{cos, hypot, sin, tan};
use flockslam_random::Random;
use std::f64::consts::TAU;

/// Wave lengths of the ground, metres: from banks beside a path to hills.
const WAVES_M: [f64; 6] = [24.0, 33.0, 47.0, 68.0, 95.0, 140.0];
/// Steepest slope, degrees.
const STEEPEST_DEG: f64 = 3.0;
/// Heights are known at points of a square lattice with this spacing, metres.
const SPACING_M: f64 = 1.0;
/// A beam is followed in steps of this length, metres.
const STEP_M: f64 = 1.5;

/// Heights over a rectangle that begins in the origin; beyond it the ground is as at its edge.
#[derive(Clone, Debug)]
pub(super) struct Terrain {
    columns: usize,
    rows: usize,
    /// Metres, row by row.
    heights_m: Vec<f64>,
}

impl Terrain {
    /// Ground of smooth waves in random directions, scaled so that its steepest slope is 3°.
    pub(super) fn new(size_m: (f64, f64), random: &mut Random) -> Self {
        let waves = WAVES_M.map(|length_m| {
            let (direction_rad, phase_rad) = (random.between(0.0, TAU), random.between(0.0, TAU));
            let number = TAU / length_m;
            // Equal slopes of all waves: short ones are low.
            (number * cos(direction_rad), number * sin(direction_rad), phase_rad, 1.0 / number)
        });
        let (columns, rows) = ((size_m.0 / SPACING_M) as usize + 2, (size_m.1 / SPACING_M) as usize + 2);
        let height_m = |i: usize| {
            let (x_m, y_m) = ((i % columns) as f64 * SPACING_M, (i / columns) as f64 * SPACING_M);
            waves.iter().map(|(u, v, phase, amplitude)| amplitude * sin(u * x_m + v * y_m + phase)).sum()
        };
        let mut terrain = Self { columns, rows, heights_m: (0..columns * rows).map(height_m).collect() };
        let steepest = terrain.steepest();
        let scale = tan(STEEPEST_DEG.to_radians()) / steepest;
        terrain.heights_m.iter_mut().for_each(|height_m| *height_m *= scale);
        terrain
    }

    /// Greatest slope between neighbouring points of the lattice.
    fn steepest(&self) -> f64 {
        let slope = |i: usize| {
            let along_x = self.heights_m[i + 1] - self.heights_m[i];
            let along_y = self.heights_m[i + self.columns] - self.heights_m[i];
            hypot(along_x, along_y) / SPACING_M
        };
        let inner = (0..self.rows - 1).flat_map(|row| (0..self.columns - 1).map(move |column| (row, column)));
        inner.map(|(row, column)| slope(row * self.columns + column)).fold(0.0, f64::max)
    }

    /// Height of the ground, metres (bilinear).
    pub(super) fn height_m(&self, at: Point) -> f64 {
        let on_axis = |value_m: f64, count: usize| {
            let position = (value_m / SPACING_M).clamp(0.0, (count - 1) as f64 - 1e-9);
            (position as usize, position.fract())
        };
        let ((column, u), (row, v)) = (on_axis(at.x_m, self.columns), on_axis(at.y_m, self.rows));
        let corner = row * self.columns + column;
        let below = self.heights_m[corner] * (1.0 - u) + self.heights_m[corner + 1] * u;
        let next = corner + self.columns;
        let above = self.heights_m[next] * (1.0 - u) + self.heights_m[next + 1] * u;
        below * (1.0 - v) + above * v
    }

    /// Slope of the ground along x and y under a small robot.
    pub(super) fn gradient(&self, at: Point) -> Point {
        let half_m = 0.5 * SPACING_M;
        let along = |dx: f64, dy: f64| {
            let (ahead, behind) =
                (Point::new(at.x_m + dx, at.y_m + dy), Point::new(at.x_m - dx, at.y_m - dy));
            (self.height_m(ahead) - self.height_m(behind)) / (2.0 * half_m)
        };
        Point::new(along(half_m, 0.0), along(0.0, half_m))
    }

    /// Distance at which a beam meets the ground, metres; infinite when it does not within `max_m`. `clearance_m` gives the
    /// beam's height above the ground.
    pub(super) fn meets(&self, clearance_m: impl Fn(f64) -> f64, max_m: f64) -> f64 {
        let (mut before_m, mut high_m) = (0.0, clearance_m(0.0));
        while before_m < max_m {
            let at_m = before_m + STEP_M;
            let now_m = clearance_m(at_m);
            if now_m <= 0.0 {
                return before_m + STEP_M * high_m / (high_m - now_m);
            }
            (before_m, high_m) = (at_m, now_m);
        }
        f64::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ground_is_as_steep_as_it_may_be_and_smooth() {
        let terrain = Terrain::new((80.0, 60.0), &mut Random::new(3, "terrain"));
        let slopes = (0..200).map(|i| {
            let at = Point::new(0.4 * f64::from(i), 0.3 * f64::from(i));
            terrain.gradient(at).norm_m().atan().to_degrees()
        });
        let steepest_deg = slopes.fold(0.0, f64::max);
        assert!((1.0..=3.01).contains(&steepest_deg), "{steepest_deg}°");
        assert!(terrain.height_m(Point::new(-5.0, 500.0)).is_finite());
    }

    #[test]
    fn a_falling_beam_meets_level_ground_where_geometry_says() {
        let terrain = Terrain { columns: 2, rows: 2, heights_m: vec![0.0; 4] };
        let met_m = terrain.meets(|at_m| 0.4 - 0.02 * at_m, 80.0);
        assert!((met_m - 20.0).abs() < 1e-9, "{met_m} m");
        assert_eq!(terrain.meets(|_| 0.4, 80.0), f64::INFINITY);
    }
}
