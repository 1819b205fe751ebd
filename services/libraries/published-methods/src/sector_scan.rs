//! The published way to look through a map: line segments of a scan in angular sectors (Trubin et al. 2020). Takes a
//! scan, classifies a point by whether the ray to it is free, hit or shadowed.

use flockslam_geometry::Point;
use flockslam_geometry::elementary::{atan2, sin_cos};
use flockslam_messages::{Deskew, ScanView};
use std::f64::consts::TAU;

/// Sectors of the full circle.
const SECTORS: usize = 1024;

/// A scan as line segments, listed by the sectors of the circle that they lie in (Trubin et al. 2020): what a ray from the
/// lidar meets is found among the few segments of its sector.
///
/// Points are in the laser frame at the scan's stamp, metres.
#[derive(Clone, Debug)]
pub struct SectorScan {
    segments: Vec<Segment>,
    /// Where the segments of each sector begin in `listed`, and one more.
    starts: Box<[u32; SECTORS + 1]>,
    listed: Vec<u32>,
    /// Sectors that beams with a return go through.
    returned: Box<[bool; SECTORS]>,
    /// How near a point is to a segment that shows it, metres.
    join_m: f64,
}

/// Two neighbouring points of the scan, and the sectors between them.
#[derive(Clone, Copy, Debug)]
struct Segment {
    start: Point,
    end: Point,
    first_sector: i64,
    last_sector: i64,
}

/// What is on the way to a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ray {
    /// A segment before it: the point is in the shadow.
    Shadowed,
    /// A segment at it.
    Met,
    /// None, although beams of that sector came back.
    Free,
    /// Nothing is known of that sector.
    Unseen,
}

impl Default for SectorScan {
    fn default() -> Self {
        Self {
            segments: Vec::new(),
            starts: Box::new([0; SECTORS + 1]),
            listed: Vec::new(),
            returned: Box::new([false; SECTORS]),
            join_m: 0.0,
        }
    }
}

impl SectorScan {
    /// Takes in a scan. Neighbouring points nearer to each other than `join_m` (the published dR) are joined.
    pub fn look(&mut self, scan: ScanView<'_>, deskew: &Deskew, join_m: f64) {
        self.join_m = join_m;
        self.segments.clear();
        self.returned.fill(false);
        let mut before: Option<(f64, Point)> = None;
        let mut first = None;
        for beam in 0..scan.len() {
            let (angle_rad, range_m) = deskew.beam_at_stamp(scan, beam);
            let here = range_m.map(|range_m| {
                let (sin, cos) = sin_cos(angle_rad);
                (angle_rad, Point::new(range_m * cos, range_m * sin))
            });
            self.join(before, here);
            first = if beam == 0 { here } else { first };
            before = here;
        }
        // The last beam of a full circle is beside the first.
        self.join(before, first.map(|(angle_rad, point)| (angle_rad + TAU, point)));
        self.list();
    }

    /// The first hit of a ray to a point.
    pub fn ray_to(&self, point: Point) -> Ray {
        let distance_m = point.norm_m();
        let sector = wrap(sector_of(atan2(point.y_m, point.x_m)));
        if !self.returned[sector] {
            return Ray::Unseen;
        }
        let listed = &self.listed[self.starts[sector] as usize..self.starts[sector + 1] as usize];
        let crossings = listed.iter().filter_map(|index| self.segments[*index as usize].crossing_m(point));
        match crossings.fold(f64::INFINITY, f64::min) {
            nearest_m if nearest_m < distance_m - self.join_m => Ray::Shadowed,
            nearest_m if nearest_m <= distance_m + self.join_m => Ray::Met,
            _ => Ray::Free,
        }
    }

    /// Joins two neighbouring points when they are near enough; marks the sectors between beams that both came back.
    fn join(&mut self, before: Option<(f64, Point)>, here: Option<(f64, Point)>) {
        let (Some((from_rad, start)), Some((to_rad, end))) = (before, here) else { return };
        let (low_rad, high_rad) = (from_rad.min(to_rad), from_rad.max(to_rad));
        if high_rad - low_rad > TAU / 8.0 {
            return;
        }
        let (first_sector, last_sector) = (sector_of(low_rad), sector_of(high_rad));
        for sector in first_sector..=last_sector {
            self.returned[wrap(sector)] = true;
        }
        if start.distance_m(end) < self.join_m {
            self.segments.push(Segment { start, end, first_sector, last_sector });
        }
    }

    /// Lists the segments by sector: counting, then filling.
    fn list(&mut self) {
        self.starts.fill(0);
        for segment in &self.segments {
            (segment.first_sector..=segment.last_sector)
                .for_each(|sector| self.starts[wrap(sector) + 1] += 1);
        }
        for sector in 0..SECTORS {
            self.starts[sector + 1] += self.starts[sector];
        }
        self.listed.clear();
        self.listed.resize(self.starts[SECTORS] as usize, 0);
        for (index, segment) in self.segments.iter().enumerate() {
            for sector in segment.first_sector..=segment.last_sector {
                let place = &mut self.starts[wrap(sector)];
                self.listed[*place as usize] = index as u32;
                *place += 1;
            }
        }
        // Each start has moved to the start of the next sector.
        self.starts.copy_within(0..SECTORS, 1);
        self.starts[0] = 0;
    }
}

impl Segment {
    /// Distance at which the ray from the origin through a point crosses the segment, metres.
    fn crossing_m(&self, through: Point) -> Option<f64> {
        let along = Point::new(self.end.x_m - self.start.x_m, self.end.y_m - self.start.y_m);
        let turn = cross(through, along);
        let share = cross(self.start, through) / turn;
        let distance_m = cross(self.start, along) / turn * through.norm_m();
        ((0.0..=1.0).contains(&share) && distance_m >= 0.0).then_some(distance_m)
    }
}

fn cross(a: Point, b: Point) -> f64 {
    a.x_m * b.y_m - a.y_m * b.x_m
}

fn sector_of(angle_rad: f64) -> i64 {
    (angle_rad * (SECTORS as f64 / TAU)).floor() as i64
}

fn wrap(sector: i64) -> usize {
    (sector & (SECTORS as i64 - 1)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;
    use proptest::prelude::*;

    const DEGREE: f64 = TAU / 360.0;

    fn sectors(ranges: &[f32], angle_min_rad: f64, step_rad: f64, join_m: f64) -> SectorScan {
        let scan = ScanBuffer::from_ranges(ranges, angle_min_rad, step_rad);
        let view = scan.view().unwrap();
        let mut sectors = SectorScan::default();
        sectors.look(view, &Deskew::new(view, flockslam_geometry::Twist::default()), join_m);
        sectors
    }

    fn at(degrees: f64, range_m: f64) -> Point {
        let (sin, cos) = (degrees * DEGREE).sin_cos();
        Point::new(range_m * cos, range_m * sin)
    }

    #[test]
    fn points_before_a_wall_are_free_and_those_behind_in_its_shadow() {
        let mut ranges = vec![2.0; 360];
        ranges[90..100].fill(f32::INFINITY);
        let sectors = sectors(&ranges, 0.0, DEGREE, 0.05);
        assert_eq!(sectors.ray_to(at(30.3, 1.5)), Ray::Free);
        assert_eq!(sectors.ray_to(at(30.3, 2.03)), Ray::Met);
        assert_eq!(sectors.ray_to(at(30.3, 3.0)), Ray::Shadowed);
        assert_eq!(sectors.ray_to(at(359.6, 3.0)), Ray::Shadowed);
        assert_eq!(sectors.ray_to(at(95.0, 1.0)), Ray::Unseen);
        let leaky = self::sectors(&ranges, 0.0, DEGREE, 0.03);
        assert_eq!(leaky.ray_to(at(30.3, 3.0)), Ray::Free, "points farther apart than dR are no wall");
    }

    proptest! {
        /// Looking at one sector finds what looking at all segments finds.
        #[test]
        fn the_sectors_leave_nothing_out(
            ranges in prop::collection::vec(prop_oneof![4 => 0.5..4.0f32, 1 => Just(f32::INFINITY)], 2..300),
            first in -4.0..4.0f64, degrees in 0.0..360.0f64, range_m in 0.3..5.0f64,
        ) {
            let sectors = sectors(&ranges, first, TAU / ranges.len() as f64, 0.3);
            let point = at(degrees, range_m);
            let all = sectors.segments.iter().filter_map(|segment| segment.crossing_m(point));
            let nearest_m = all.fold(f64::INFINITY, f64::min);
            match sectors.ray_to(point) {
                Ray::Shadowed => prop_assert!(nearest_m < range_m - 0.3),
                Ray::Met => prop_assert!((nearest_m - range_m).abs() <= 0.3 + 1e-9),
                Ray::Free | Ray::Unseen => prop_assert!(nearest_m > range_m + 0.3 - 1e-9),
            }
        }
    }
}
