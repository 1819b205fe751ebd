//! Which places a scan cannot see for certain: a bound of its ranges by coarse direction, without an arc tangent for each place.

use crate::PolarRangeImage;
use flockslam_geometry::elementary::{atan2, hypot};
use std::f64::consts::FRAC_1_SQRT_2;

/// Coarse directions around the lidar; a quarter of them in each quadrant.
const DIRECTIONS: usize = 256;
/// Nearer places fill too much of the view to be called hidden here, metres.
const NEAR_M: f64 = 1.0;
/// Rounding of angles stays below this, radians.
const ROUNDING_RAD: f64 = 1e-6;

/// The farthest range of a scan in each coarse direction around the lidar.
#[derive(Clone, Debug)]
pub struct Horizon {
    /// Directions at which the coarse ones begin, radians, and where the last one ends.
    borders_rad: Box<[f64; DIRECTIONS + 1]>,
    farthest_m: Box<[f64; DIRECTIONS]>,
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
            let along = number as f64 * (4.0 / DIRECTIONS as f64) - 1.0;
            if along <= 1.0 { atan2(along, 1.0 - along.abs()) } else { turned(along - 2.0) }
        };
        Self {
            borders_rad: Box::new(std::array::from_fn(border)),
            farthest_m: Box::new([0.0; DIRECTIONS]),
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
    /// [`crate::PassThrough::judge`] says that it is open.
    #[inline]
    pub fn hides(&self, dx_m: f64, dy_m: f64) -> bool {
        let share = dy_m / (dx_m.abs() + dy_m.abs());
        let along = if dx_m >= 0.0 { share + 1.0 } else { 3.0 - share };
        let direction = ((along * (DIRECTIONS as f64 / 4.0)) as usize).min(DIRECTIONS - 1);
        let distance_m = hypot(dx_m, dy_m);
        distance_m >= NEAR_M && self.farthest_m[direction] < distance_m - self.near_m
    }
}

/// The direction so far behind the negative axis of x, in the measure that is the share of y in |x| + |y|.
fn turned(along: f64) -> f64 {
    std::f64::consts::PI + atan2(along, 1.0 - along.abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Margins, PassThrough, Visibility};
    use flockslam_geometry::{Point, Pose, Twist};
    use flockslam_messages::{Deskew, ScanBuffer};
    use proptest::prelude::*;

    const CELL_M: f64 = 0.05;
    const MARGINS: Margins =
        Margins { behind_m: 0.15, behind_share: 0.015, beside_m: 0.06, beside_rad: 0.005 };

    proptest! {
        #[test]
        fn what_is_hidden_is_judged_open(
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
                    prop_assert_eq!(pass_through.judge(center), Visibility::Open, "{:?}", center);
                }
            }
            // About two fifths of the circle are out of view.
            prop_assert!(hidden > 60, "{}", hidden);
        }
    }
}
