//! Integer sums over the beams of a scan. Sums over parts of a scan add up to those of the whole, to the bit, so that several
//! processes can share a scan.

use flockslam_geometry::Pose;
use flockslam_messages::{ScanSections, ScanTally, ScanView, TALLY_BINS, TALLY_SECTORS};
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Units of range in a metre.
pub(crate) const UNITS_PER_M: f32 = 1024.0;
/// Ranges beyond count as this, metres: in units they stay below [`ONES`].
const RANGE_CAP_M: f32 = 8191.0;
/// From here to twice as much the numbers of single precision are the whole ones: what is added to this is rounded to units.
const ONES: f32 = 8_388_608.0;
/// Ranges of which the sum in units stays within 32 bits.
const CHUNK: usize = 256;
/// Beams that enter the histogram at least: one of a thousand is as good as one of all.
const BINNED: usize = 1024;

/// Adds up the beams of `beams`; a pair of neighbours belongs to its first beam. The sum over any division of a scan into
/// ranges is the same to the bit.
pub fn tally(scan: ScanView<'_>, beams: Range<usize>) -> ScanTally {
    let mut tally = ScanTally { id: scan.header().id, parts: 1, ..ScanTally::default() };
    let places = Places::of(scan);
    let beams = beams.start..beams.end.min(scan.len());
    let mut at = beams.start;
    while at < beams.end {
        let (place, end) = places.run(scan, at, beams.end);
        take_beams(&mut tally, scan, at..end, place);
        at = end;
    }
    tally
}

/// Where a beam counts: its sector, and whether ranges that fall along a corridor count up: front and left, or neither.
type Place = (usize, bool);

/// How angles become places.
struct Places {
    /// Turns sectors with odometry, radians: while the robot turns on the spot, walls stay in their sectors.
    turned_rad: f64,
    /// From the laser's to the robot's frame, radians.
    mounted_rad: f64,
    /// Beams over which even angles pass through a sector, no more.
    stride: usize,
}

impl Places {
    fn of(scan: ScanView<'_>) -> Self {
        let header = scan.header();
        let mounted_rad = header.base_from_laser.heading_rad;
        let heading_rad = scan.odometry().unwrap_or(Pose::IDENTITY).heading_rad;
        let has_even_angles = header.sections & ScanSections::ANGLES == 0;
        let in_sector = TAU / TALLY_SECTORS as f64 / header.angle_increment_rad.abs();
        // Without an increment this is infinite: the length of the scan is as good.
        let stride =
            if has_even_angles { (in_sector.ceil() as usize).clamp(1, scan.len().max(1)) } else { 1 };
        Self { turned_rad: mounted_rad + heading_rad, mounted_rad, stride }
    }

    /// The place of a beam, and where the beams end that follow it in the same place, `limit` at most.
    fn run(&self, scan: ScanView<'_>, start: usize, limit: usize) -> (Place, usize) {
        let place = self.of_beam(scan, start);
        let end = (start + self.stride).min(limit);
        if end - start == 1 || self.of_beam(scan, end - 1) == place {
            return (place, end);
        }
        // Even angles leave a place only once: the last beam known to be in it, and the first known not to be.
        let (mut last, mut next) = (start, end - 1);
        while next - last > 1 {
            let middle = last.midpoint(next);
            if self.of_beam(scan, middle) == place { last = middle } else { next = middle }
        }
        (place, next)
    }

    fn of_beam(&self, scan: ScanView<'_>, beam: usize) -> Place {
        let angle_rad = scan.angle_rad(beam);
        let quadrant = part_of_turn(angle_rad + self.mounted_rad, 4);
        (sector_of(angle_rad + self.turned_rad), quadrant.is_multiple_of(2))
    }
}

fn sector_of(angle_rad: f64) -> usize {
    part_of_turn(angle_rad + PI, TALLY_SECTORS)
}

/// In which of so many equal parts of a turn an angle is; one that is not finite in the first.
fn part_of_turn(angle_rad: f64, parts: usize) -> usize {
    let turns = angle_rad * (1.0 / TAU);
    let beyond_whole = turns - turns as i64 as f64;
    let share = if beyond_whole < 0.0 { beyond_whole + 1.0 } else { beyond_whole };
    ((share * parts as f64) as usize).min(parts - 1)
}

/// A range in units, rounded.
#[inline(always)]
fn units(range_m: f32) -> u32 {
    let capped_m = if range_m < RANGE_CAP_M { range_m } else { RANGE_CAP_M };
    (capped_m * UNITS_PER_M + ONES).to_bits().wrapping_sub(ONES.to_bits())
}

/// Of so many beams one enters the histogram.
fn bin_every(beams: usize) -> usize {
    (beams / BINNED).checked_ilog2().map_or(1, |power| 1 << power)
}

/// Bins are 0.4 m wide; the last takes all ranges from 11.6 m on.
fn bin_of(units: u32) -> usize {
    ((units * 5) >> 11).min(TALLY_BINS as u32 - 1) as usize
}

/// Adds beams that share a place.
fn take_beams(tally: &mut ScanTally, scan: ScanView<'_>, beams: Range<usize>, (sector, rises): Place) {
    let limits_m = (scan.header().range_min_m.max(0.0), scan.header().range_max_m);
    let seen = &scan.ranges()[beams.start..(beams.end + 1).min(scan.len())];
    let ranges_m = &seen[..beams.len()];
    // Behind the last beam of a scan there is none: as if that one were not valid.
    let is_last = seen.len() == beams.len();
    let paired = if is_last { beams.len() - 1 } else { beams.len() };
    let mut sums = Sums::default();
    for (first, second) in ranges_m[..paired].chunks(CHUNK).zip(seen[1..].chunks(CHUNK)) {
        sums.add(first, second, limits_m);
    }
    if is_last {
        sums.add(&ranges_m[paired..], &[f32::NAN], limits_m);
    }
    tally.range_sums[sector] += sums.units;
    tally.counts[sector] += sums.valid;
    tally.corridor += i64::from(if rises { sums.falls } else { -sums.falls });
    tally.pairs += u64::from(sums.pairs);
    let every = bin_every(scan.len());
    let to_first = beams.start.next_multiple_of(every) - beams.start;
    let picked = ranges_m.iter().skip(to_first).step_by(every);
    for range_m in picked.filter(|range_m| limits_m.0 <= **range_m && **range_m <= limits_m.1) {
        tally.bins[bin_of(units(*range_m))] += 1;
    }
}

/// The sums of the beams of one place.
#[derive(Debug, Default)]
struct Sums {
    units: u64,
    valid: u32,
    /// Pairs of which the second range is the smaller one, less those of which it is the larger.
    falls: i32,
    pairs: u32,
}

impl Sums {
    /// Adds ranges and the neighbour of each, the next one; at most [`CHUNK`].
    fn add(&mut self, first_m: &[f32], second_m: &[f32], limits_m: (f32, f32)) {
        #[cfg(target_arch = "x86_64")]
        if first_m.len() == CHUNK && std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.add_with_avx2(first_m, second_m, limits_m) };
        }
        self.add_plainly(first_m, second_m, limits_m);
    }

    /// The same, for processors that handle eight numbers at once.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn add_with_avx2(&mut self, first_m: &[f32], second_m: &[f32], limits_m: (f32, f32)) {
        self.add_plainly(first_m, second_m, limits_m);
    }

    #[inline(always)]
    fn add_plainly(&mut self, first_m: &[f32], second_m: &[f32], limits_m: (f32, f32)) {
        let is_valid = |range_m: f32| (limits_m.0 <= range_m) & (range_m <= limits_m.1);
        // Nothing wraps: a chunk has 256 ranges of less than 2^23 units. Said so, the compiler need not look, here and below.
        let valid = first_m.iter().fold(0_u32, |valid, a| valid.wrapping_add(u32::from(is_valid(*a))));
        if valid as usize == first_m.len() && second_m.last().is_none_or(|last| is_valid(*last)) {
            self.add_valid(first_m, second_m);
        } else {
            self.add_mixed(first_m, second_m, is_valid);
        }
        self.valid += valid;
    }

    /// Valid ranges. A loop without branches, for the compiler to vectorise, as the next one.
    #[inline(always)]
    fn add_valid(&mut self, first_m: &[f32], second_m: &[f32]) {
        let (mut sum, mut falls) = (0_u32, 0_i32);
        for (a, b) in first_m.iter().zip(second_m) {
            sum = sum.wrapping_add(units(*a));
            falls = falls.wrapping_add(i32::from(a > b).wrapping_sub(i32::from(a < b)));
        }
        self.units += u64::from(sum);
        self.falls += falls;
        self.pairs += first_m.len() as u32;
    }

    /// Ranges of which some are not valid.
    #[inline(always)]
    fn add_mixed(&mut self, first_m: &[f32], second_m: &[f32], is_valid: impl Fn(f32) -> bool) {
        let (mut sum, mut falls, mut pairs) = (0_u32, 0_i32, 0_u32);
        for (a, b) in first_m.iter().zip(second_m) {
            let (a_valid, both_valid) = (is_valid(*a), is_valid(*a) & is_valid(*b));
            sum = sum.wrapping_add(if a_valid { units(*a) } else { 0 });
            let fall = i32::from(both_valid & (a > b)).wrapping_sub(i32::from(both_valid & (a < b)));
            falls = falls.wrapping_add(fall);
            pairs = pairs.wrapping_add(u32::from(both_valid));
        }
        self.units += u64::from(sum);
        self.falls += falls;
        self.pairs += pairs;
    }
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
    fn beams_may_have_angles_of_their_own() {
        let even = ScanBuffer::from_ranges(&[2.0, 1.5, 4.0, 3.0], -3.0, 1.5);
        let mut own = even.clone();
        own.header.sections = ScanSections::ANGLES;
        own.numbers.extend([-3.0, -1.5, 0.0, 1.5]);
        assert_eq!(tally(own.view().unwrap(), 0..4), tally(even.view().unwrap(), 0..4));
        assert_eq!(tally(own.view().unwrap(), 4..4).valid(), 0);
    }

    #[test]
    fn sectors_turn_with_odometry() {
        let look = |heading_rad: f64| {
            let mut scan = ScanBuffer::from_ranges(&[3.0], 0.05 - heading_rad, 0.0);
            (scan.header.odometry.heading_rad, scan.header.has_odometry) = (heading_rad, 1);
            tally(scan.view().unwrap(), 0..1).counts
        };
        assert_eq!(look(0.0), look(1.0));
    }

    /// A scan of many beams with all kinds of ranges, and stretches of only valid ones between.
    fn large(beams: usize, seed: u64) -> ScanBuffer {
        let mut state = seed | 1;
        let range = |beam: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            match if (beam / 700).is_multiple_of(2) { 15 } else { state >> 60 } {
                0 => f32::NAN,
                1 => f32::INFINITY,
                2 => 0.001,
                _ => (state >> 40) as f32 * 1e-6,
            }
        };
        let ranges: Vec<f32> = (0..beams).map(range).collect();
        let mut scan = ScanBuffer::from_ranges(&ranges, -PI, TAU / beams.max(1) as f64);
        (scan.header.range_min_m, scan.header.range_max_m) = (0.05, 16.0);
        scan
    }

    proptest! {
        #[test]
        fn runs_count_as_beams_do(
            beams in prop_oneof![1_usize..1500, 99_000_usize..100_000], turns in 0.01_f64..2.5,
            start_rad in -4.0_f64..4.0, heading_rad in -4.0_f64..4.0, backwards in any::<bool>(), seed in any::<u64>(),
        ) {
            let mut scan = large(beams, seed);
            let step_rad = turns * TAU / beams as f64;
            scan.header.angle_min_rad = start_rad;
            scan.header.angle_increment_rad = if backwards { -step_rad } else { step_rad };
            (scan.header.odometry.heading_rad, scan.header.has_odometry) = (heading_rad, 1);
            scan.header.base_from_laser.heading_rad = heading_rad / 3.0;
            let view = scan.view().unwrap();
            let mut one_by_one = ScanTally { parts: 1, ..ScanTally::default() };
            let places = Places::of(view);
            (0..beams).for_each(|beam| {
                take_beams(&mut one_by_one, view, beam..beam + 1, places.of_beam(view, beam));
            });
            prop_assert_eq!(tally(view, 0..beams), one_by_one);
        }

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
