//! Sectors of the circle around the lidar, as numbers (`Sector`) and at a place (`Wedge`). Each point is in exactly one.

use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_visibility::Directions;
use std::f64::consts::TAU;

/// One of several equal sectors of the circle around the lidar: the share of one replica of the cleaner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sector {
    part: u32,
    parts: u32,
    /// The circle begins so many [`TURNS`]-ths of a sector away from the lidar's x-axis.
    turned: u32,
}

/// Places that the borders of sectors can have.
pub(crate) const TURNS: u32 = 8;

/// A sector at its place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wedge {
    apex: Point,
    /// It is to the left of this direction, and not to the left of that one, as far as there are such.
    begins: Option<Point>,
    ends: Option<Point>,
}

impl Sector {
    /// The whole circle.
    pub const WHOLE: Self = Self { part: 0, parts: 1, turned: 0 };

    /// Number `part` (from 0) of `parts` sectors; the first begins at the lidar's x-axis.
    pub fn new(part: u32, parts: u32) -> Self {
        assert!(part < parts, "a sector is one of its circle");
        Self { part, parts, turned: 0 }
    }

    /// How many there are.
    pub(crate) fn parts(self) -> u32 {
        self.parts
    }

    /// The same of a circle that begins so many [`TURNS`]-ths of a sector further.
    pub(crate) fn turned(self, turned: u32) -> Self {
        Self { turned, ..self }
    }

    /// Where sector `number` begins, as a share of the circle from the lidar's x-axis on.
    fn beginning(self, number: u32) -> f64 {
        (f64::from(number) + f64::from(self.turned) / f64::from(TURNS)) / f64::from(self.parts)
    }

    /// Directions in the laser frame that lie in it or up to `beside_rad` beside it.
    pub(crate) fn directions(self, beside_rad: f64) -> Directions {
        let half_rad = 0.5 * TAU / f64::from(self.parts);
        Directions { middle_rad: TAU * self.beginning(self.part) + half_rad, half_rad: half_rad + beside_rad }
    }

    /// The sector of a lidar at this pose.
    pub(crate) fn wedge(self, laser: Pose) -> Wedge {
        // Neighbours compute their common border in the same way.
        let border = |number: u32| {
            let (sin, cos) = sin_cos(laser.heading_rad + TAU * self.beginning(number % self.parts));
            Point::new(cos, sin)
        };
        // Two halves have one line between them, whose ends may not agree to the last digit.
        let (begins, ends) = match (self.parts, self.part) {
            (1, _) => (None, None),
            (2, 0) => (Some(border(0)), None),
            (2, _) => (None, Some(border(0))),
            (_, part) => (Some(border(part)), Some(border(part + 1))),
        };
        Wedge { apex: laser.position(), begins, ends }
    }
}

impl Wedge {
    /// Whether a point is in it. Every point but the apex is in the wedge of exactly one sector.
    pub fn has(&self, point: Point) -> bool {
        let (x, y) = (point.x_m - self.apex.x_m, point.y_m - self.apex.y_m);
        let is_left = |border: Point| left_m(border, x, y) >= 0.0;
        self.begins.is_none_or(is_left) && !self.ends.is_some_and(is_left)
    }

    /// Whether it certainly has no point within `radius_m` of another.
    pub fn misses(&self, center: Point, radius_m: f64) -> bool {
        let (x, y) = (center.x_m - self.apex.x_m, center.y_m - self.apex.y_m);
        self.begins.is_some_and(|border| left_m(border, x, y) < -radius_m)
            || self.ends.is_some_and(|border| left_m(border, x, y) > radius_m)
    }
}

/// How far (x, y) is to the left of a direction, metres.
fn left_m(direction: Point, x: f64, y: f64) -> f64 {
    direction.x_m * y - direction.y_m * x
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_point_is_of_one_sector(
            x in -20.0..20.0_f64, y in -20.0..20.0_f64, heading in -4.0..4.0_f64, parts in 1_u32..9, turned in 0..TURNS,
        ) {
            let laser = Pose::new(1.0, -3.0, heading);
            let sectors = (0..parts).map(|part| Sector::new(part, parts).turned(turned).wedge(laser));
            prop_assert_eq!(sectors.filter(|wedge| wedge.has(Point::new(x, y))).count(), 1);
        }

        /// Points on the borders too, as far as numbers can lie there.
        #[test]
        fn every_point_of_a_lattice_is_of_one_sector(
            x in -20..20_i32, y in -20..20_i32, quarter in 0..8_i32, parts in 1_u32..9,
        ) {
            prop_assume!((x, y) != (0, 0));
            let laser = Pose::new(1.0, 2.0, TAU / 8.0 * f64::from(quarter));
            let point = Point::new(1.0 + f64::from(x), 2.0 + f64::from(y));
            let sectors = (0..parts).map(|part| Sector::new(part, parts).wedge(laser));
            prop_assert_eq!(sectors.filter(|wedge| wedge.has(point)).count(), 1);
        }
    }

    proptest! {
        #[test]
        fn what_a_wedge_misses_has_no_point_of_it(
            x in -5.0..5.0_f64, y in -5.0..5.0_f64, radius_m in 0.0..3.0_f64, turn in 0.0..TAU, parts in 1_u32..6,
        ) {
            let center = Point::new(x, y);
            let point = Point::new(x + 0.99 * radius_m * turn.cos(), y + 0.99 * radius_m * turn.sin());
            for part in 0..parts {
                let wedge = Sector::new(part, parts).wedge(Pose::new(0.5, 0.0, 0.7));
                prop_assert!(!(wedge.misses(center, radius_m) && wedge.has(point)));
            }
        }
    }

    #[test]
    fn the_first_sector_begins_at_the_axis_of_the_lidar() {
        let laser = Pose::new(2.0, 0.0, 1.0);
        let at = |direction_rad: f64| Point::new(2.0 + direction_rad.cos(), direction_rad.sin());
        for (part, middle_rad) in [(0, 1.5), (1, 2.0 + TAU / 4.0), (3, 0.5)] {
            assert!(Sector::new(part, 4).wedge(laser).has(at(middle_rad)), "part {part}");
        }
    }
}
