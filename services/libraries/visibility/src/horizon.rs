//! Which places a scan cannot see for certain: a bound of its ranges by coarse direction, without an arc tangent for each place.

use crate::PolarRangeImage;
use flockslam_geometry::Point;
use flockslam_geometry::elementary::{atan2, hypot};
use std::f64::consts::FRAC_1_SQRT_2;
use std::ops::Range;

/// Coarse directions around a place; a quarter of them in each quadrant.
pub const COARSE_DIRECTIONS: usize = 256;
/// Nearer places fill too much of the view to be called hidden here, metres.
const NEAR_M: f64 = 1.0;
/// Rounding of angles stays below this, radians.
const ROUNDING_RAD: f64 = 1e-6;
/// Slack for the rounding of distances.
const ROUNDING_M: f64 = 1e-6;

/// The farthest range of a scan in each coarse direction around the lidar.
#[derive(Clone, Debug)]
pub struct Horizon {
    /// Directions at which the coarse ones begin, radians, and where the last one ends.
    borders_rad: Box<[f64; COARSE_DIRECTIONS + 1]>,
    farthest_m: Box<[f64; COARSE_DIRECTIONS]>,
    /// Cells closer in front of what is seen may be part of it, metres.
    near_m: f64,
}

impl Default for Horizon {
    fn default() -> Self {
        Self::new()
    }
}

impl Horizon {
    /// Of a scan that sees nothing.
    pub fn new() -> Self {
        let border = |number: usize| {
            let along = number as f64 * (4.0 / COARSE_DIRECTIONS as f64) - 1.0;
            if along <= 1.0 { atan2(along, 1.0 - along.abs()) } else { turned(along - 2.0) }
        };
        Self {
            borders_rad: Box::new(std::array::from_fn(border)),
            farthest_m: Box::new([0.0; COARSE_DIRECTIONS]),
            near_m: 0.0,
        }
    }

    /// Takes the ranges of a scan whose lidar has this heading in the frame of the cells, radians; cells have this side, metres.
    pub fn look(&mut self, sight: &PolarRangeImage, heading_rad: f64, cell_size_m: f64) {
        // Half the diagonal of a cell, as it is seen from the nearest place that is called hidden.
        let beside_rad = FRAC_1_SQRT_2 * cell_size_m / NEAR_M + ROUNDING_RAD;
        for (farthest_m, borders) in self.farthest_m.iter_mut().zip(self.borders_rad.windows(2)) {
            *farthest_m = sight
                .farthest_m(borders[0] - heading_rad - beside_rad, borders[1] - heading_rad + beside_rad);
        }
        self.near_m = 2.0 * cell_size_m;
    }

    /// Whether a cell whose centre is this far from the lidar along x and y is hidden, or out of view, for certain:
    /// [`crate::PassThrough::classify`] says that it is open.
    #[inline]
    pub fn hides(&self, dx_m: f64, dy_m: f64) -> bool {
        let distance_m = hypot(dx_m, dy_m);
        distance_m >= NEAR_M && self.farthest_m[coarse_direction(dx_m, dy_m)] < distance_m - self.near_m
    }

    /// Whether [`Self::hides`] is true of every place well within the rectangle between two corners, which are given as seen from the
    /// lidar.
    pub fn hides_all(&self, low: Point, high: Point) -> bool {
        let away_m = |low_m: f64, high_m: f64| low_m.max(-high_m).max(0.0);
        let nearest_m = hypot(away_m(low.x_m, high.x_m), away_m(low.y_m, high.y_m)) - ROUNDING_M;
        if nearest_m < NEAR_M {
            return false;
        }
        let hidden = |directions: &[f64]| directions.iter().all(|far_m| *far_m < nearest_m - self.near_m);
        coarse_directions(low, high).into_iter().all(|range| hidden(&self.farthest_m[range]))
    }
}

/// The coarse directions of the rectangle between two corners, which are given as seen from a place outside of it: two ranges, one of them
/// empty unless the directions begin anew in between.
pub fn coarse_directions(low: Point, high: Point) -> [Range<usize>; 2] {
    let corners = [(low.x_m, low.y_m), (high.x_m, low.y_m), (low.x_m, high.y_m), (high.x_m, high.y_m)];
    let corners = corners.map(|(x_m, y_m)| coarse_direction(x_m, y_m));
    let (first, last) =
        corners.iter().fold((COARSE_DIRECTIONS, 0), |(first, last), d| (first.min(*d), last.max(*d)));
    // It is seen within less than half a turn. Where its corners are farther apart the directions begin anew in between.
    let half = COARSE_DIRECTIONS / 2;
    if last - first <= half {
        return [first..last + 1, 0..0];
    }
    let least = corners.into_iter().filter(|d| *d >= half).min().unwrap_or(half);
    let most = corners.into_iter().filter(|d| *d < half).max().unwrap_or(0);
    [least..COARSE_DIRECTIONS, 0..most + 1]
}

/// The number of the direction of what is so far away along x and y.
#[inline]
pub fn coarse_direction(dx_m: f64, dy_m: f64) -> usize {
    let share = dy_m / (dx_m.abs() + dy_m.abs());
    let along = if dx_m >= 0.0 { share + 1.0 } else { 3.0 - share };
    ((along * (COARSE_DIRECTIONS as f64 / 4.0)) as usize).min(COARSE_DIRECTIONS - 1)
}

/// The direction so far behind the negative axis of x, in the measure that is the share of y in |x| + |y|.
fn turned(along: f64) -> f64 {
    std::f64::consts::PI + atan2(along, 1.0 - along.abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Margins, PassThrough, Visibility};
    use flockslam_geometry::{Pose, Twist};
    use flockslam_messages::{Deskew, ScanBuffer};
    use proptest::prelude::*;

    const CELL_M: f64 = 0.05;
    const MARGINS: Margins =
        Margins { behind_m: 0.15, behind_share: 0.015, beside_m: 0.06, beside_rad: 0.005 };

    proptest! {
        #[test]
        fn hidden_cells_are_classified_as_open(
            ranges in prop::collection::vec(0.5..9.0_f32, 180), heading_rad in -3.1..3.1_f64, first_rad in -3.1..3.1_f64,
            cells in prop::collection::vec((-200..200_i32, -200..200_i32), 300),
        ) {
            // Objects several beams wide.
            let ranges: Vec<f32> = (0..180).map(|beam| ranges[beam / 12 * 12]).collect();
            let scan = ScanBuffer::from_ranges(&ranges, first_rad, 0.02);
            let (view, mut sight, mut horizon) = (scan.view().unwrap(), PolarRangeImage::new(), Horizon::new());
            sight.look(view, &Deskew::new(view, Twist::default()));
            let laser = Pose::new(0.013, -0.021, heading_rad);
            horizon.look(&sight, laser.heading_rad, CELL_M);
            let pass_through = PassThrough::new(&sight, laser, CELL_M, MARGINS);
            let mut hidden = 0;
            for (x, y) in cells {
                let center = Point::new((f64::from(x) + 0.5) * CELL_M, (f64::from(y) + 0.5) * CELL_M);
                let (dx, dy) = (center.x_m - laser.x_m, center.y_m - laser.y_m);
                if horizon.hides(dx, dy) {
                    hidden += 1;
                    prop_assert_eq!(pass_through.classify(center), Visibility::Open, "{:?}", center);
                }
            }
            // About two fifths of the circle are out of view.
            prop_assert!(hidden > 60, "{}", hidden);
            let mut hidden = 0;
            for (x, y) in (-12..12).flat_map(|y| (-12..12).map(move |x| (x, y))) {
                let corner = |x: i32, y: i32| Point::new(0.8 * f64::from(x) - laser.x_m, 0.8 * f64::from(y) - laser.y_m);
                if horizon.hides_all(corner(x, y), corner(x + 1, y + 1)) {
                    hidden += 1;
                    for (column, row) in (0..16).flat_map(|row| (0..16).map(move |column| (column, row))) {
                        let away = |cell: i32, part: i32| (f64::from(16 * cell + part) + 0.5) * CELL_M;
                        let (dx, dy) = (away(x, column) - laser.x_m, away(y, row) - laser.y_m);
                        prop_assert!(horizon.hides(dx, dy), "{} {}", dx, dy);
                    }
                }
            }
            prop_assert!(hidden > 100, "{}", hidden);
        }
    }
}
