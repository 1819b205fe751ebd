//! Ranges of a scan by direction, to decide whether a point of another scan is in its free space.

use flockslam_geometry::elementary::atan2;
use flockslam_registration::cloud::{PackedPoint, Placement};
use std::f64::consts::{PI, TAU};

/// Directions of one degree each.
const SECTORS: usize = 360;
/// A point must be this much in front of the range to count as in free space, metres.
const MARGIN_M: f64 = 0.3;
/// A point within this distance of the range is on the same surface, metres.
const SAME_M: f64 = 0.2;

/// How far a scan saw in each direction.
pub struct Polar {
    nearest_m: [f64; SECTORS],
    /// The nearest point of each sector alone; 0 where there is none.
    sector_m: [f64; SECTORS],
}

impl Polar {
    /// The nearest point of the scan in each sector and its two neighbours.
    pub fn new(points: &[PackedPoint]) -> Self {
        let mut sector_m = [0.0f64; SECTORS];
        for point in points {
            let (x, y) = (point.x_m(), point.y_m());
            let range_m = (x * x + y * y).sqrt();
            let entry = &mut sector_m[sector(x, y)];
            if *entry == 0.0 || range_m < *entry {
                *entry = range_m;
            }
        }
        let around = |i: usize| [(i + SECTORS - 1) % SECTORS, i, (i + 1) % SECTORS].map(|k| sector_m[k]);
        // A sector is only compared where the scan saw something on both sides too.
        let nearest = |i| if sector_m[i] == 0.0 { 0.0 } else { least(around(i)) };
        Self { nearest_m: std::array::from_fn(nearest), sector_m }
    }

    /// Whether the scan, taken at `at`, looked through the point (x, y) metres of the same frame: `None` when
    /// the scan did not observe it.
    pub fn looked_through(&self, at: &Placement, x_m: f64, y_m: f64) -> Option<bool> {
        let (x, y) = at.unrotate(x_m - at.x_m, y_m - at.y_m);
        let seen_m = self.nearest_m[sector(x, y)];
        (seen_m > 0.0).then(|| (x * x + y * y).sqrt() + MARGIN_M < seen_m)
    }

    /// Whether the scan, taken at `at`, saw something at the point (x, y) metres of the same frame (true) or looked through it (false): `None`
    /// when it is neither.
    pub fn shows(&self, at: &Placement, x_m: f64, y_m: f64) -> Option<bool> {
        let (x, y) = at.unrotate(x_m - at.x_m, y_m - at.y_m);
        let (sector, range_m) = (sector(x, y), (x * x + y * y).sqrt());
        let around = [sector + SECTORS - 1, sector, sector + 1].map(|k| self.sector_m[k % SECTORS]);
        if around.iter().any(|seen_m| *seen_m > 0.0 && (range_m - seen_m).abs() <= SAME_M) {
            return Some(true);
        }
        let nearest_m = self.nearest_m[sector];
        (nearest_m > 0.0 && range_m + MARGIN_M < nearest_m).then_some(false)
    }
}

fn least(ranges: [f64; 3]) -> f64 {
    ranges.into_iter().filter(|&r| r > 0.0).fold(f64::INFINITY, f64::min)
}

fn sector(x: f64, y: f64) -> usize {
    (((atan2(y, x) + PI) * (SECTORS as f64 / TAU)) as usize).min(SECTORS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knows_free_space_from_walls_and_from_what_it_did_not_see() {
        let wall: Vec<_> =
            (-300..300).filter_map(|i| PackedPoint::from_metres(4.0, f64::from(i) * 0.01)).collect();
        let polar = Polar::new(&wall);
        let at = Placement::new(1.0, 0.0, 0.0);
        assert_eq!(polar.looked_through(&at, 3.0, 0.2), Some(true));
        assert_eq!(polar.looked_through(&at, 5.0, 0.2), Some(false));
        assert_eq!(polar.looked_through(&at, 7.0, 0.2), Some(false));
        assert_eq!(polar.looked_through(&at, -3.0, 0.2), None);
        assert_eq!(polar.shows(&at, 5.1, 0.2), Some(true));
        assert_eq!(polar.shows(&at, 3.0, 0.2), Some(false));
        assert_eq!(polar.shows(&at, 7.0, 0.2), None, "behind the wall");
    }
}
