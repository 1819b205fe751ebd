//! The directions around a lidar in which something is looked for: beams elsewhere need not be followed.

use flockslam_geometry::Point;
use flockslam_visibility::{COARSE_DIRECTIONS, coarse_direction, coarse_directions};

/// Coarse directions around a place.
#[derive(Clone, Debug)]
pub struct DirectionSet {
    is_wanted: Box<[bool; COARSE_DIRECTIONS]>,
}

impl DirectionSet {
    /// Nowhere.
    pub fn new() -> Self {
        Self { is_wanted: Box::new([false; COARSE_DIRECTIONS]) }
    }

    /// Nowhere again.
    pub fn clear(&mut self) {
        self.is_wanted.fill(false);
    }

    /// At all that is at most so far beside the rectangle between two corners, which are given as seen from the lidar.
    pub fn add(&mut self, low: Point, high: Point, beside_m: f64) {
        let (left, bottom) = (low.x_m - beside_m, low.y_m - beside_m);
        let (right, top) = (high.x_m + beside_m, high.y_m + beside_m);
        if left <= 0.0 && right >= 0.0 && bottom <= 0.0 && top >= 0.0 {
            return self.is_wanted.fill(true);
        }
        for directions in coarse_directions(Point::new(left, bottom), Point::new(right, top)) {
            self.is_wanted[directions].fill(true);
        }
    }

    /// Whether something that is so far from the lidar along x and y is looked for.
    #[inline]
    pub fn has(&self, dx_m: f64, dy_m: f64) -> bool {
        self.is_wanted[coarse_direction(dx_m, dy_m)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_place_in_a_rectangle_and_beside_it_is_looked_at(
            x in -6.0..6.0f64, y in -6.0..6.0f64, along in 0.0..1.0f64, across in 0.0..1.0f64,
        ) {
            let mut directions = DirectionSet::new();
            directions.add(Point::new(x, y), Point::new(x + 0.8, y + 0.8), 0.2);
            prop_assert!(directions.has(x - 0.2 + 1.2 * along, y - 0.2 + 1.2 * across));
            // Not all around, unless the lidar is there.
            let is_here = |low: f64| (-1.0..=0.2).contains(&low);
            prop_assert!(is_here(x) && is_here(y) || !directions.is_wanted.iter().all(|wanted| *wanted));
            directions.clear();
            prop_assert!(!directions.has(x, y));
        }
    }
}
