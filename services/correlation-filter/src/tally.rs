use flockslam_geometry::{Pose, wrap_angle};
use flockslam_messages::{ScanTally, ScanView, TALLY_BINS, TALLY_SECTORS};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

/// Units of range in a metre.
pub(crate) const UNITS_PER_M: f32 = 1024.0;
/// Ranges beyond count as this, metres: a block's sum stays within 32 bits.
const RANGE_CAP_M: f32 = 8191.0;
/// Beams that are taken together where they all fall into one sector.
const BLOCK: usize = 256;
/// Scans with fewer beams are taken beam by beam: their sectors are narrower than a block.
const BLOCKS_FROM: usize = 16_384;
/// Of so many beams one enters the histogram there: a histogram of a thousand is as good as one of all.
const BIN_EVERY: usize = 16;
/// What stands for a range that is not valid.
const INVALID: i32 = -1;

/// Adds up the beams of `beams`; a pair of neighbours belongs to its first beam. The sum over any division of a scan into
/// ranges is the same to the bit.
pub fn tally(scan: ScanView<'_>, beams: Range<usize>) -> ScanTally {
    let mut tally = ScanTally { id: scan.header().id, parts: 1, ..ScanTally::default() };
    let places = Places::of(scan);
    let beams = beams.start..beams.end.min(scan.len());
    let length = places.block(scan);
    let is_large = scan.len() >= BLOCKS_FROM && length == BLOCK;
    let bin_every = if is_large { BIN_EVERY } else { 1 };
    let mut at = beams.start;
    while at < beams.end {
        let end = (at + length).min(beams.end);
        let place = places.of_beam(scan, at);
        let is_one_place = length > 1 && place == places.of_beam(scan, end - 1);
        if is_one_place && is_large {
            take_block(&mut tally, scan, at..end, place);
        } else {
            for beam in at..end {
                let place = if is_one_place { place } else { places.of_beam(scan, beam) };
                take_beam(&mut tally, scan, beam, place, bin_every);
            }
        }
        at = end;
    }
    tally
}

/// Where a beam counts: its sector, and which sign falling ranges have along a corridor.
type Place = (usize, bool);

/// How angles become places.
struct Places {
    /// Turns sectors with the wheels, radians: while the robot turns on the spot, walls stay in their sectors.
    turned_rad: f64,
    /// From the laser's to the robot's frame, radians.
    mounted_rad: f64,
}

impl Places {
    fn of(scan: ScanView<'_>) -> Self {
        let mounted_rad = scan.header().base_from_laser.heading_rad;
        let heading_rad = scan.odometry().unwrap_or(Pose::IDENTITY).heading_rad;
        Self { turned_rad: mounted_rad + heading_rad, mounted_rad }
    }

    /// Beams in a row, at most [`BLOCK`], over which even angles change so little that equal places at both ends are equal in between.
    fn block(&self, scan: ScanView<'_>) -> usize {
        let header = scan.header();
        if header.sections & flockslam_messages::ScanSections::ANGLES != 0 {
            return 1;
        }
        let sector_rad = TAU / TALLY_SECTORS as f64;
        let is_narrow = |length: &usize| header.angle_increment_rad.abs() * (*length as f64) < sector_rad;
        [BLOCK, BLOCK / 8, 8, 4].into_iter().find(is_narrow).unwrap_or(1)
    }

    fn of_beam(&self, scan: ScanView<'_>, beam: usize) -> Place {
        let angle_rad = scan.angle_rad(beam);
        let angle = wrap_angle(angle_rad + self.mounted_rad);
        (sector_of(angle_rad + self.turned_rad), (angle.abs() < FRAC_PI_2) == (angle > 0.0))
    }
}

/// An angle that is not finite falls into sector 0.
fn sector_of(angle_rad: f64) -> usize {
    let turn = (angle_rad + PI) * (1.0 / TAU);
    let share = turn - turn.floor();
    ((share * TALLY_SECTORS as f64) as usize).min(TALLY_SECTORS - 1)
}

/// A range in units; [`INVALID`] for one that is not valid.
fn units(range_m: f32, limits_m: (f32, f32)) -> i32 {
    let valid = limits_m.0 <= range_m && range_m <= limits_m.1;
    if valid { (range_m.clamp(0.0, RANGE_CAP_M) * UNITS_PER_M) as i32 } else { INVALID }
}

/// Bins are 0.4 m wide; the last takes all ranges from 11.6 m on.
fn bin_of(units: i32) -> usize {
    ((units * 5) >> 11).min(TALLY_BINS as i32 - 1) as usize
}

fn take_beam(tally: &mut ScanTally, scan: ScanView<'_>, beam: usize, place: Place, bin_every: usize) {
    let limits_m = (scan.header().range_min_m, scan.header().range_max_m);
    let here = units(scan.ranges()[beam], limits_m);
    if here == INVALID {
        return;
    }
    tally.range_sums[place.0] += here as u64;
    tally.counts[place.0] += 1;
    if beam.is_multiple_of(bin_every) {
        tally.bins[bin_of(here)] += 1;
    }
    let next = scan.ranges().get(beam + 1).map_or(INVALID, |range| units(*range, limits_m));
    if next != INVALID {
        let falls = i64::from(here > next) - i64::from(here < next);
        tally.corridor += if place.1 { falls } else { -falls };
        tally.pairs += 1;
    }
}

/// The same for beams of one place, in loops that the compiler can vectorise.
fn take_block(tally: &mut ScanTally, scan: ScanView<'_>, beams: Range<usize>, place: Place) {
    let limits_m = (scan.header().range_min_m, scan.header().range_max_m);
    let mut here = [INVALID; BLOCK + 1];
    let seen = &scan.ranges()[beams.start..(beams.end + 1).min(scan.len())];
    here.iter_mut().zip(seen).for_each(|(here, range)| *here = units(*range, limits_m));
    let (first, second) = (&here[..beams.len()], &here[1..=beams.len()]);
    // Nothing wraps: a block has 256 ranges below 2^23. Said so, the compiler need not look.
    let (mut sum, mut valid, mut falls, mut pairs) = (0_i32, 0_i32, 0_i32, 0_i32);
    for (a, b) in first.iter().zip(second) {
        let (a_valid, b_valid) = (i32::from(*a >= 0), i32::from(*b >= 0));
        sum = sum.wrapping_add((*a).max(0));
        valid = valid.wrapping_add(a_valid);
        let fall = i32::from(*a > *b).wrapping_sub(i32::from(*a < *b));
        falls = falls.wrapping_add((a_valid & b_valid).wrapping_mul(fall));
        pairs = pairs.wrapping_add(a_valid & b_valid);
    }
    tally.range_sums[place.0] += sum as u64;
    tally.counts[place.0] += valid as u32;
    tally.corridor += i64::from(if place.1 { falls } else { -falls });
    tally.pairs += pairs as u64;
    let to_first = beams.start.next_multiple_of(BIN_EVERY) - beams.start;
    let picked = first.iter().skip(to_first).step_by(BIN_EVERY).filter(|units| **units != INVALID);
    picked.for_each(|units| tally.bins[bin_of(*units)] += 1);
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;
    use proptest::prelude::*;

    #[test]
    fn sectors_go_round_the_circle() {
        assert_eq!(sector_of(-PI), 0);
        assert_eq!(sector_of(0.01), TALLY_SECTORS / 2);
        assert_eq!(sector_of(PI - 1e-9), TALLY_SECTORS - 1);
        assert_eq!(sector_of(0.01 + 3.0 * TAU), TALLY_SECTORS / 2);
        assert!(
            [f64::NAN, f64::INFINITY, -1e300, 1e300].map(sector_of).into_iter().all(|s| s < TALLY_SECTORS)
        );
    }

    #[test]
    fn a_beam_counts_in_its_sector_bin_and_pair() {
        let mut scan = ScanBuffer::from_ranges(&[2.0, 1.0, f32::NAN, 100.0, f32::INFINITY], 0.05, 0.1);
        scan.header.range_max_m = 200.0;
        let sum = tally(scan.view().unwrap(), 0..5);
        assert_eq!((sum.valid(), sum.pairs, sum.corridor), (3, 1, 1));
        assert_eq!((sum.counts[30], sum.range_sums[30]), (1, 2048));
        assert_eq!((sum.bins[2], sum.bins[5], sum.bins[29]), (1, 1, 1));
    }

    #[test]
    fn sectors_turn_with_the_wheels() {
        let look = |heading_rad: f64| {
            let mut scan = ScanBuffer::from_ranges(&[3.0], 0.05 - heading_rad, 0.0);
            (scan.header.odometry.heading_rad, scan.header.has_odometry) = (heading_rad, 1);
            tally(scan.view().unwrap(), 0..1).counts
        };
        assert_eq!(look(0.0), look(1.0));
    }

    /// A scan of many beams with all kinds of ranges.
    fn large(beams: usize, seed: u64) -> ScanBuffer {
        let mut state = seed | 1;
        let mut range = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            match state >> 60 {
                0 => f32::NAN,
                1 => f32::INFINITY,
                2 => 0.001,
                _ => (state >> 40) as f32 * 1e-6,
            }
        };
        let ranges: Vec<f32> = (0..beams).map(|_| range()).collect();
        let mut scan = ScanBuffer::from_ranges(&ranges, -PI, TAU / beams.max(1) as f64);
        (scan.header.range_min_m, scan.header.range_max_m) = (0.05, 16.0);
        scan
    }

    #[test]
    fn blocks_count_as_beams_do() {
        let scan = large(100_000, 7);
        let view = scan.view().unwrap();
        let mut one_by_one = ScanTally { parts: 1, ..ScanTally::default() };
        let places = Places::of(view);
        (0..view.len()).for_each(|beam| {
            take_beam(&mut one_by_one, view, beam, places.of_beam(view, beam), BIN_EVERY);
        });
        assert_eq!(tally(view, 0..view.len()), one_by_one);
    }

    proptest! {
        #[test]
        fn parts_sum_up_to_the_whole(
            beams in prop_oneof![0_usize..400, 16_000_usize..40_000],
            cuts in prop::collection::vec(0_usize..40_000, 0..5), seed in any::<u64>(),
        ) {
            let scan = large(beams, seed);
            let view = scan.view().unwrap();
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(beams)).collect();
            cuts.extend([0, beams]);
            cuts.sort_unstable();
            let mut sum = ScanTally { parts: 1, ..ScanTally::default() };
            cuts.windows(2).for_each(|part| sum.add(&tally(view, part[0]..part[1])));
            prop_assert_eq!(sum, tally(view, 0..beams));
        }
    }
}
