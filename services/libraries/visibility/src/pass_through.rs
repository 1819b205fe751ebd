//! Judges single cells of a map by a scan: passed through, supported, or open. Takes the scan, its pose and margins
//! for errors.

use crate::polar_range_image::SPACING_MAX_RAD;
use crate::{Horizon, PolarRangeImage};
use flockslam_geometry::elementary::atan2;
use flockslam_geometry::{Point, Pose};
use std::f64::consts::SQRT_2;

/// Nearer cells are not classified, metres: they fill too much of the view, and the robot may see itself.
const NEAR_M: f64 = 0.3;

/// Where a beam passes a cell, no beam ends within so many cells of it.
const PASSED_CELLS: f64 = 2.5;

/// The classification of an occupied cell by a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visibility {
    /// A beam through it and every beam near it end far behind it.
    SeenThrough,
    /// A beam through it ends far behind it, but one near it does not: at a grazing angle that is how the cells in front of a wall
    /// look, and with errors of poses those of the wall itself.
    Passed,
    /// A beam through it ends far behind it, and one beside that ends at it: it is the edge of something.
    Touched,
    /// A beam ends at it.
    Supported,
    /// Hidden, out of view, or too close to call.
    Open,
}

/// How much clearer than bare geometry a view of a cell must be, since poses, ranges and directions have errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margins {
    /// A beam through a cell ends this far behind it, metres …
    pub behind_m: f64,
    /// … plus this share of the cell's distance.
    pub behind_share: f64,
    /// So do all beams that pass within this distance beside it, metres …
    pub beside_m: f64,
    /// … plus this angle, radians.
    pub beside_rad: f64,
}

impl Margins {
    /// Of a cell of this size no beam is looked at that goes farther beside it than so much, radians, if the cell is no nearer than
    /// `nearest_m`.
    pub fn beside_max_rad(&self, cell_size_m: f64, nearest_m: f64) -> f64 {
        let beside_m = (SQRT_2 * 0.5 * cell_size_m + self.beside_m).max(PASSED_CELLS * cell_size_m);
        beside_m / nearest_m.max(NEAR_M) + SPACING_MAX_RAD + self.beside_rad
    }
}

/// A scan at its pose, ready to classify cells.
///
/// ```
/// use flockslam_geometry::{Point, Pose, Twist};
/// use flockslam_messages::{Deskew, ScanBuffer};
/// use flockslam_visibility::{Visibility, Margins, PolarRangeImage, PassThrough};
///
/// // A wall 5 m away all around, and something 2 m ahead on some of the beams.
/// let mut ranges = vec![5.0; 360];
/// ranges[..=15].fill(2.0);
/// let scan = ScanBuffer::from_ranges(&ranges, 0.0, 1f64.to_radians());
/// let mut sight = PolarRangeImage::new();
/// sight.look(scan.view()?, &Deskew::new(scan.view()?, Twist::default()));
///
/// let margins = Margins { behind_m: 0.15, behind_share: 0.015, beside_m: 0.1, beside_rad: 0.003 };
/// let view = PassThrough::new(&sight, Pose::IDENTITY, 0.045, margins);
/// let (sin, cos) = 8f64.to_radians().sin_cos();
/// assert_eq!(view.classify(Point::new(2.0 * cos, 2.0 * sin)), Visibility::Supported);
/// assert_eq!(view.classify(Point::new(3.5 * cos, 3.5 * sin)), Visibility::Open, "hidden");
/// assert_eq!(view.classify(Point::new(-2.0 * cos, -2.0 * sin)), Visibility::SeenThrough);
/// # Ok::<(), flockslam_messages::ScanProblem>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct PassThrough<'a> {
    sight: &'a PolarRangeImage,
    horizon: Option<&'a Horizon>,
    from_laser: Pose,
    cell_size_m: f64,
    margins: Margins,
}

impl<'a> PassThrough<'a> {
    /// The scan of a lidar at `from_laser`, in the frame of the cells, whose side is `cell_size_m`.
    pub fn new(sight: &'a PolarRangeImage, from_laser: Pose, cell_size_m: f64, margins: Margins) -> Self {
        Self { sight, horizon: None, from_laser, cell_size_m, margins }
    }

    /// The same judgements, sooner where a cell is hidden: `horizon` is that of the scan.
    pub fn with_horizon(self, horizon: &'a Horizon) -> Self {
        Self { horizon: Some(horizon), ..self }
    }

    /// Whether the scan looks through the cell with its centre at `center`. Beside the beams through the cell itself
    /// those next to it must pass too: at a grazing angle one of them ends on the wall to which the cell belongs.
    pub fn classify(&self, center: Point) -> Visibility {
        let (dx, dy) = (center.x_m - self.from_laser.x_m, center.y_m - self.from_laser.y_m);
        if self.horizon.is_some_and(|horizon| horizon.hides(dx, dy)) {
            return Visibility::Open;
        }
        let distance_m = (dx * dx + dy * dy).sqrt();
        if distance_m < NEAR_M {
            return Visibility::Open;
        }
        let direction_rad = atan2(dy, dx) - self.from_laser.heading_rad;
        let half_width_rad = 0.5 * self.cell_size_m / distance_m;
        let behind_m = self.margins.behind_m + self.margins.behind_share * distance_m;
        let beyond_m = distance_m + behind_m;
        // A cell may lie across the border of two beams, of which one passes and the other ends at it.
        let near_m = (2.0 * self.cell_size_m).min(behind_m);
        let is_met = |half_rad: f64, near_m: f64| {
            self.sight.ends_between(direction_rad, half_rad, distance_m - near_m, distance_m + near_m)
        };
        let passes = self.sight.range_m(direction_rad) > beyond_m;
        if passes && self.all_pass(direction_rad, distance_m, beyond_m) {
            return Visibility::SeenThrough;
        }
        if is_met(SQRT_2 * half_width_rad, near_m) {
            return if passes { Visibility::Touched } else { Visibility::Supported };
        }
        let around = PASSED_CELLS * self.cell_size_m;
        if passes
            && self.sight.beam_goes(direction_rad, SQRT_2 * half_width_rad)
            && !is_met(around / distance_m, around)
        {
            return Visibility::Passed;
        }
        Visibility::Open
    }

    /// Whether a beam goes through a cell, and it and all beside it end beyond.
    fn all_pass(&self, direction_rad: f64, distance_m: f64, beyond_m: f64) -> bool {
        let half_width_rad = 0.5 * self.cell_size_m / distance_m;
        let beside_rad = SQRT_2 * half_width_rad
            + self.margins.beside_m / distance_m
            + self.sight.spacing_rad()
            + self.margins.beside_rad;
        self.sight.nearest_m(direction_rad, beside_rad) > beyond_m
            && self.sight.beam_goes(direction_rad, half_width_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Twist;
    use flockslam_messages::{Deskew, ScanBuffer};
    use proptest::prelude::*;

    const CELL_M: f64 = 0.045;
    const MARGINS: Margins =
        Margins { behind_m: 0.15, behind_share: 0.015, beside_m: 0.1, beside_rad: 0.003 };

    fn sight_of(scan: &ScanBuffer) -> PolarRangeImage {
        let (view, mut sight) = (scan.view().unwrap(), PolarRangeImage::new());
        sight.look(view, &Deskew::new(view, Twist::default()));
        sight
    }

    /// A wall at 5 m all around, and beams 10 … 20 of 360 on something at 2 m.
    fn column() -> ScanBuffer {
        let mut ranges = vec![5.0_f32; 360];
        ranges[10..=20].fill(2.0);
        ScanBuffer::from_ranges(&ranges, 0.0, 1f64.to_radians())
    }

    fn at(distance_m: f64, degrees: f64) -> Point {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Point::new(distance_m * cos, distance_m * sin)
    }

    #[test]
    fn what_stands_is_supported_up_to_its_edges_and_what_has_gone_is_seen_through() {
        let sight = sight_of(&column());
        let view = PassThrough::new(&sight, Pose::IDENTITY, CELL_M, MARGINS);
        assert_eq!(view.classify(at(2.0, 15.0)), Visibility::Supported);
        assert_eq!(view.classify(at(2.0, 100.0)), Visibility::SeenThrough);
        assert_eq!(view.classify(at(2.0, 22.0)), Visibility::Open, "it may be the edge");
        assert_eq!(
            view.classify(at(2.0, 25.0)),
            Visibility::Passed,
            "so near to the edge nothing is certain"
        );
        assert_eq!(view.classify(at(3.5, 15.0)), Visibility::Open, "hidden");
        assert_eq!(view.classify(at(0.2, 100.0)), Visibility::Open, "too near");
        assert_eq!(view.classify(at(4.95, 100.0)), Visibility::Supported);
    }

    proptest! {
        /// Wherever the border between two beams is in the cell at the edge of a thing.
        #[test]
        fn a_cell_across_the_border_of_two_beams_of_which_one_ends_at_it_is_not_taken_for_gone(
            first in 0.0..360.0_f64, heading_rad in -3.0..3.0_f64, within in 0.0..0.6_f64,
        ) {
            let mut scan = column();
            scan.header.angle_min_rad = first.to_radians();
            let sight = sight_of(&scan);
            let pose = Pose::new(1.0, -2.0, heading_rad);
            let view = PassThrough::new(&sight, pose, CELL_M, MARGINS);
            // The last beam on the thing covers half a degree beyond itself, the cell ± 0.64°.
            let edge = at(2.0, first + 20.5 + within);
            let finding = view.classify(pose.apply(edge));
            prop_assert!(matches!(finding, Visibility::Supported | Visibility::Touched), "{finding:?}");
        }
    }
}
