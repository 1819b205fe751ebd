//! A scan as a profile of ranges by angle, a histogram of ranges and a share of corridor pattern (An. Filatov 2021,
//! chapter 4), made from its tally.

use crate::tally::UNITS_PER_M;
use flockslam_messages::{ScanTally, TALLY_BINS, TALLY_SECTORS};

/// Fewer common sectors than this do not show that nothing has changed.
const COMMON_MIN: usize = 4;

/// A scan in few numbers that do not depend on how many beams it has.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Description {
    /// Mean valid range in each sector, metres; NaN in a sector without any.
    pub profile_m: [f32; TALLY_SECTORS],
    /// Share of the valid ranges in each bin.
    pub histogram: [f32; TALLY_BINS],
    /// How much the scan looks like one taken along a corridor, 0 … 1: `|Σ sgn(r_i − r_{i+1}) · front · left| / N` over
    /// neighbouring valid beams, where `front` and `left` are ±1 in the robot's frame (An. Filatov 2021, chapter 4).
    /// Between two parallel walls ranges grow towards front and back on both sides, so all terms have one sign.
    pub corridor: f64,
}

impl Description {
    /// The sums of the beams of a whole scan. A dropout changes only its own sector.
    pub fn of(tally: &ScanTally) -> Self {
        // An empty sector divides zero by zero, which is the NaN that marks it.
        let mean =
            |i: usize| tally.range_sums[i] as f64 / f64::from(tally.counts[i]) / f64::from(UNITS_PER_M);
        let binned = tally.bins.iter().sum::<u32>().max(1) as f32;
        Self {
            profile_m: std::array::from_fn(|i| mean(i) as f32),
            histogram: tally.bins.map(|count| count as f32 / binned),
            corridor: tally.corridor.unsigned_abs() as f64 / tally.pairs.max(1) as f64,
        }
    }

    /// The change of mean range that four of five sectors do not exceed, metres; infinite where too little is common.
    pub fn change_m(&self, old: &Self) -> f32 {
        let mut changes = [f32::INFINITY; TALLY_SECTORS];
        let pairs = self.profile_m.iter().zip(&old.profile_m);
        let common = pairs.map(|(a, b)| (a - b).abs()).filter(|change| change.is_finite());
        let count = changes.iter_mut().zip(common).map(|(place, change)| *place = change).count();
        if count < COMMON_MIN {
            return f32::INFINITY;
        }
        *changes[..count].select_nth_unstable_by(4 * count / 5, f32::total_cmp).1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tally::tally;
    use flockslam_messages::ScanBuffer;

    fn describe(scan: &ScanBuffer) -> Description {
        Description::of(&tally(scan.view().unwrap(), 0..usize::MAX))
    }

    #[test]
    fn a_dropout_changes_its_own_sector_only() {
        let mut ranges: Vec<f32> = (0..180_u8).map(|i| 1.0 + f32::from(i) * 0.01).collect();
        let of = |ranges: &[f32]| describe(&ScanBuffer::from_ranges(ranges, -1.55, 0.0174));
        let before = of(&ranges);
        ranges[90] = f32::INFINITY;
        let after = of(&ranges);
        let changed = (0..TALLY_SECTORS)
            .filter(|i| before.profile_m[*i].to_bits() != after.profile_m[*i].to_bits())
            .count();
        assert_eq!(changed, 1);
        assert!((after.histogram.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        assert!(after.change_m(&before) < 1e-6);
    }

    #[test]
    fn a_change_of_a_quarter_of_the_sectors_is_seen() {
        let mut ranges = [2.0_f32; 360];
        let of = |ranges: &[f32]| describe(&ScanBuffer::from_ranges(ranges, -3.1, 0.01745));
        let before = of(&ranges);
        ranges[..90].fill(2.1);
        assert!((of(&ranges).change_m(&before) - 0.1).abs() < 2e-3);
        assert_eq!(before.change_m(&of(&[1.0])), f32::INFINITY);
    }

    #[test]
    fn a_scan_without_returns_is_described() {
        let empty = describe(&ScanBuffer::from_ranges(&[], 0.0, 0.1));
        assert!(empty.corridor == 0.0 && empty.profile_m.iter().all(|m| m.is_nan()));
        assert!(empty.histogram.iter().all(|share| *share == 0.0));
    }

    /// Ranges from a point between two walls at y = ±1.5 m, seen by 360 beams over the circle.
    fn between_walls(heading_rad: f64) -> ScanBuffer {
        let step = std::f64::consts::TAU / 360.0;
        let range = |i: i32| {
            let angle = f64::from(i) * step - std::f64::consts::PI + heading_rad;
            (1.5 / angle.sin().abs()).min(60.0) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), -std::f64::consts::PI, step)
    }

    #[test]
    fn a_corridor_is_recognised_along_its_axis_however_the_lidar_is_mounted() {
        assert!(describe(&between_walls(0.0)).corridor > 0.9);
        for mounted_rad in [0.7, -1.2, 2.5] {
            let mut turned = between_walls(mounted_rad);
            turned.header.base_from_laser.heading_rad = mounted_rad;
            assert!(describe(&turned).corridor > 0.9, "{mounted_rad}");
        }
        assert_eq!(describe(&ScanBuffer::from_ranges(&[2.0; 360], -3.1, 0.017)).corridor, 0.0);
    }
}
