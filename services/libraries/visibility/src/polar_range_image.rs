//! The ranges of a scan by direction: takes a scan once, answers questions about directions in constant time.

use flockslam_messages::{Deskew, ScanView};
use std::f64::consts::TAU;

/// Sectors of the full circle, 0.35° each.
const SECTORS: usize = 1024;
/// A beam covers directions up to this far from it, radians, when its neighbours are farther away.
const HALF_FOOTPRINT_MAX_RAD: f64 = 0.035;
/// Beams are taken to be no farther apart, radians.
pub(crate) const SPACING_MAX_RAD: f64 = 2.0 * HALF_FOOTPRINT_MAX_RAD;
/// No beam in a sector.
const NONE: f32 = f32::NAN;

/// How far a scan sees in every direction, looked up in constant time for any order of beams.
///
/// Each beam covers the directions up to half way to its neighbours. Where beams overlap the nearest counts; a beam
/// without return, and a direction without beam, sees nothing (range 0).
#[derive(Clone, Debug)]
pub struct PolarRangeImage {
    range_m: Box<[f32; SECTORS]>,
    /// Direction of a beam in the sector, radians from the sector's lower edge; NaN when there is none.
    beam_rad: Box<[f32; SECTORS]>,
    /// Mean angle between neighbouring beams, radians.
    spacing_rad: f64,
}

impl Default for PolarRangeImage {
    fn default() -> Self {
        Self::new()
    }
}

/// Directions in the laser frame that are of interest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Directions {
    /// The middle of them, radians.
    pub middle_rad: f64,
    /// They reach so far to both sides of it, radians.
    pub half_rad: f64,
}

impl Directions {
    /// The whole circle.
    pub const ALL: Self = Self { middle_rad: 0.0, half_rad: f64::INFINITY };

    fn is_all(self) -> bool {
        self.half_rad >= 0.5 * TAU
    }

    /// Whether something `half_rad` wide to both sides of a direction touches a sector that one of these is in.
    fn has(self, angle_rad: f64, half_rad: f64) -> bool {
        let away = angle_rad - self.middle_rad;
        let away = (away - TAU * (away / TAU).round()).abs();
        away <= self.half_rad + half_rad + 2.0 * TAU / SECTORS as f64
    }
}

/// Directions from `low` to `high`, in sectors; they may go round the circle.
#[derive(Clone, Copy, Debug)]
struct Span {
    low: i64,
    high: i64,
}

impl PolarRangeImage {
    /// Sees nothing.
    pub fn new() -> Self {
        Self { range_m: Box::new([0.0; SECTORS]), beam_rad: Box::new([NONE; SECTORS]), spacing_rad: 0.0 }
    }

    /// Takes in a scan; directions are angles in the laser frame at the scan's stamp.
    pub fn look(&mut self, scan: ScanView<'_>, deskew: &Deskew) {
        self.look_toward(scan, deskew, Directions::ALL);
    }

    /// As [`Self::look`], but takes in only what can be seen in some directions: in others it may see nothing.
    pub fn look_toward(&mut self, scan: ScanView<'_>, deskew: &Deskew, toward: Directions) {
        self.range_m.fill(f32::INFINITY);
        self.beam_rad.fill(NONE);
        let mut sum_rad = 0.0;
        for beam in 0..scan.len() {
            let angle = scan.angle_rad(beam);
            let half = half_footprint(scan, beam, angle);
            sum_rad += 2.0 * half;
            if toward.is_all() || toward.has(angle, half + deskew.shift_max_rad(scan, beam)) {
                self.take(deskew.beam_at_stamp(scan, beam), half);
            }
        }
        self.range_m.iter_mut().filter(|range| range.is_infinite()).for_each(|range| *range = 0.0);
        self.spacing_rad = sum_rad / scan.len().max(1) as f64;
    }

    fn take(&mut self, (angle, range_m): (f64, Option<f64>), half_rad: f64) {
        let range_m = range_m.unwrap_or(0.0) as f32;
        for sector in span(angle - half_rad, angle + half_rad).sectors() {
            self.range_m[sector] = self.range_m[sector].min(range_m);
        }
        let place = sectors_of(angle);
        let sector = floor(place);
        self.beam_rad[wrap(sector)] = ((place - sector as f64) * TAU / SECTORS as f64) as f32;
    }

    /// Mean angle between neighbouring beams, radians.
    pub fn spacing_rad(&self) -> f64 {
        self.spacing_rad
    }

    /// The range in a direction, metres; 0 where the scan sees nothing.
    pub fn range_m(&self, angle_rad: f64) -> f64 {
        f64::from(self.range_m[wrap(floor(sectors_of(angle_rad)))])
    }

    /// The shortest range within `half_rad` of a direction, metres; 0 where the scan sees nothing.
    pub fn nearest_m(&self, angle_rad: f64, half_rad: f64) -> f64 {
        let nearest = span(angle_rad - half_rad, angle_rad + half_rad)
            .sectors()
            .fold(f32::INFINITY, |nearest, sector| nearest.min(self.range_m[sector]));
        f64::from(nearest)
    }

    /// The longest range from one direction to another, metres.
    pub(crate) fn farthest_m(&self, from_rad: f64, to_rad: f64) -> f64 {
        let farthest = span(from_rad, to_rad)
            .sectors()
            .fold(0.0, |farthest: f32, sector| farthest.max(self.range_m[sector]));
        f64::from(farthest)
    }

    /// Whether a beam within `half_rad` of a direction ends between two ranges, metres.
    pub fn ends_between(&self, angle_rad: f64, half_rad: f64, from_m: f64, to_m: f64) -> bool {
        span(angle_rad - half_rad, angle_rad + half_rad)
            .sectors()
            .any(|sector| (from_m..=to_m).contains(&f64::from(self.range_m[sector])))
    }

    /// Whether a beam goes within `half_rad` of a direction.
    pub fn beam_goes(&self, angle_rad: f64, half_rad: f64) -> bool {
        let place = sectors_of(angle_rad);
        let to_rad = TAU / SECTORS as f64;
        let directions = span(angle_rad - half_rad, angle_rad + half_rad);
        (directions.low..=directions.high).any(|sector| {
            let beam_rad = (sector as f64 - place) * to_rad + f64::from(self.beam_rad[wrap(sector)]);
            beam_rad.abs() <= half_rad
        })
    }
}

impl Span {
    fn sectors(self) -> impl Iterator<Item = usize> {
        (self.low..=self.high).map(wrap)
    }
}

/// At most one turn, whatever the angles.
fn span(low_rad: f64, high_rad: f64) -> Span {
    let (low, high) = (floor(sectors_of(low_rad)), floor(sectors_of(high_rad)));
    Span { low, high: high.clamp(low, low.saturating_add(SECTORS as i64 - 1)) }
}

/// The sector of a place between sectors; a cast and a comparison cost less than the function of the library.
#[inline]
fn floor(place: f64) -> i64 {
    let truncated = place as i64;
    truncated.saturating_sub(i64::from(place < truncated as f64))
}

fn sectors_of(angle_rad: f64) -> f64 {
    angle_rad * (SECTORS as f64 / TAU)
}

fn wrap(sector: i64) -> usize {
    (sector & (SECTORS as i64 - 1)) as usize
}

/// Half the angle to the nearer neighbour in the order of the beams.
fn half_footprint(scan: ScanView<'_>, beam: usize, angle_rad: f64) -> f64 {
    let step = |other: usize| (scan.angle_rad(other) - angle_rad).abs();
    let before = beam.checked_sub(1).map_or(f64::INFINITY, step);
    let after = if beam + 1 < scan.len() { step(beam + 1) } else { f64::INFINITY };
    (0.5 * before.min(after)).min(HALF_FOOTPRINT_MAX_RAD)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Twist;
    use flockslam_messages::{ScanBuffer, ScanSections};
    use proptest::prelude::*;

    fn look(sight: &mut PolarRangeImage, scan: &ScanBuffer) {
        let view = scan.view().unwrap();
        sight.look(view, &Deskew::new(view, flockslam_geometry::Twist::default()));
    }

    const DEGREE: f64 = TAU / 360.0;

    fn sight(ranges: &[f32], angle_min_rad: f64, step_rad: f64) -> PolarRangeImage {
        let mut sight = PolarRangeImage::new();
        look(&mut sight, &ScanBuffer::from_ranges(ranges, angle_min_rad, step_rad));
        sight
    }

    #[test]
    fn every_direction_between_beams_is_covered_by_the_nearest_of_them() {
        let mut ranges = vec![5.0; 181];
        ranges[90] = 2.0;
        ranges[120] = f32::INFINITY;
        let sight = sight(&ranges, -90.0 * DEGREE, DEGREE);
        assert!((sight.spacing_rad() - DEGREE).abs() < 1e-3);
        assert_eq!(sight.nearest_m(0.0, 0.2 * DEGREE), 2.0);
        assert_eq!(sight.nearest_m(10.3 * DEGREE, 2.0 * DEGREE), 5.0);
        assert_eq!(sight.nearest_m(30.0 * DEGREE, 0.1 * DEGREE), 0.0);
        assert_eq!(sight.nearest_m(180.0 * DEGREE, 0.1 * DEGREE), 0.0);
        assert!(
            sight.ends_between(0.0, 0.1 * DEGREE, 1.9, 2.1)
                && !sight.ends_between(0.0, 0.1 * DEGREE, 2.1, 4.0)
        );
        assert_eq!((sight.range_m(0.0), sight.range_m(20.5 * DEGREE), sight.range_m(3.0)), (2.0, 5.0, 0.0));
        // Near the border of two beams a sector may belong to either: what is less than a sector beyond it is left out.
        for tenth in -895..=895_i32 {
            let degrees = f64::from(tenth) / 10.0;
            let (from_near, from_lost) = (degrees.abs(), (degrees - 30.0).abs());
            let expected_m = if from_near < 0.45 {
                2.0
            } else if from_lost < 0.45 {
                0.0
            } else if from_near.min(from_lost) > 0.9 {
                5.0
            } else {
                continue;
            };
            assert_eq!(sight.range_m(degrees * DEGREE), expected_m, "{degrees}");
        }
    }

    #[test]
    fn beams_are_found_across_the_seam_of_the_circle() {
        let sight = sight(&[3.0; 360], 0.5 * DEGREE, DEGREE);
        assert!(sight.beam_goes(-0.5 * DEGREE, 0.1 * DEGREE));
        assert!(sight.beam_goes(359.5 * DEGREE, 0.1 * DEGREE));
        assert!(!sight.beam_goes(0.0, 0.1 * DEGREE));
        assert_eq!(sight.nearest_m(7.0, 1.0), 3.0);
    }

    #[test]
    fn explicit_angles_in_reverse_order_give_the_same_sight() {
        let degrees = |list: &[f64]| {
            let mut scan = ScanBuffer::from_ranges(&[], 0.0, 0.0);
            scan.header.beam_count = list.len() as u32;
            scan.header.sections = ScanSections::ANGLES;
            scan.numbers = list.iter().map(|d| *d as f32 * 0.1 + 1.0).collect();
            scan.numbers.extend(list.iter().map(|d| (*d * DEGREE) as f32));
            let mut sight = PolarRangeImage::new();
            look(&mut sight, &scan);
            sight.range_m
        };
        assert_eq!(degrees(&[0.0, 1.0, 2.0, 3.0]), degrees(&[3.0, 2.0, 1.0, 0.0]));
    }

    proptest! {
        #[test]
        fn in_the_directions_of_interest_the_same_is_seen(
            ranges in prop::collection::vec(0.3..20.0_f32, 2..400), first in -4.0..4.0_f64, turn in -2.0..2.0_f64,
            middle_rad in -9.0..9.0_f64, half_rad in 0.05..4.0_f64, within in -1.0..1.0_f64,
        ) {
            let mut scan = ScanBuffer::from_ranges(&ranges, first, TAU / ranges.len() as f64);
            scan.header.time_increment_s = 0.1 / ranges.len() as f32;
            (scan.header.base_from_laser.x_m, scan.header.base_from_laser.heading_rad) = (0.2, 0.4);
            let view = scan.view().unwrap();
            let deskew = Deskew::new(view, Twist { x_m_s: 0.8, turn_rad_s: turn, ..Twist::default() });
            let (mut all, mut some) = (PolarRangeImage::new(), PolarRangeImage::new());
            all.look(view, &deskew);
            some.look_toward(view, &deskew, Directions { middle_rad, half_rad });
            let direction = middle_rad + within * half_rad;
            prop_assert_eq!(all.spacing_rad(), some.spacing_rad());
            prop_assert_eq!(all.range_m(direction), some.range_m(direction));
            prop_assert_eq!(all.beam_goes(direction, 0.0), some.beam_goes(direction, 0.0));
        }

        #[test]
        fn any_scan_is_survived(ranges in prop::collection::vec(any::<f32>(), 0..40), first in -1e6..1e6_f64, step in -10.0..10.0_f64) {
            let sight = sight(&ranges, first, step);
            prop_assert!(sight.nearest_m(first, 100.0) >= 0.0);
            prop_assert!(sight.beam_goes(first, 1e-3) || ranges.len() != 1);
            prop_assert!(sight.range_m(first) >= sight.nearest_m(first, 0.1));
        }
    }
}
