use flockslam_messages::ScanView;
use std::f64::consts::{PI, TAU};

/// Sectors of the full circle: 6° each, so half a circle has the 30 of the source.
pub(crate) const SECTORS: usize = 60;
/// Bins of the histogram of ranges.
pub(crate) const BINS: usize = 30;
/// Ranges from here on share the last bin; indoors nearly all are below.
const HISTOGRAM_RANGE_M: f64 = 12.0;

/// A scan in few numbers that do not depend on how many beams it has.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Description {
    /// Mean valid range in each sector of the laser frame, metres; NaN in a sector without any.
    pub profile_m: [f32; SECTORS],
    /// Share of the valid ranges in each bin.
    pub histogram: [f32; BINS],
    /// Number of valid ranges.
    pub valid: u32,
}

impl Description {
    /// Of all valid beams: a dropout changes its own sector and no other.
    pub fn of(scan: ScanView<'_>) -> Self {
        let (mut sums, mut counts, mut bins) = ([0.0_f64; SECTORS], [0_u32; SECTORS], [0_u32; BINS]);
        let per_metre = BINS as f64 / HISTOGRAM_RANGE_M;
        let mut valid = 0;
        for beam in 0..scan.len() {
            let Some(range_m) = scan.valid_range_m(beam) else { continue };
            let sector = sector_of(scan.angle_rad(beam));
            sums[sector] += range_m;
            counts[sector] += 1;
            bins[((range_m * per_metre) as usize).min(BINS - 1)] += 1;
            valid += 1;
        }
        // An empty sector divides zero by zero, which is the NaN that marks it.
        let profile_m = std::array::from_fn(|i| (sums[i] / f64::from(counts[i])) as f32);
        let histogram = bins.map(|count| count as f32 / valid.max(1) as f32);
        Self { profile_m, histogram, valid }
    }
}

/// An angle that is not finite falls into sector 0.
fn sector_of(angle_rad: f64) -> usize {
    let turn = (angle_rad + PI) * (1.0 / TAU);
    let share = turn - turn.floor();
    ((share * SECTORS as f64) as usize).min(SECTORS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    #[test]
    fn sectors_go_round_the_circle() {
        assert_eq!(sector_of(-PI), 0);
        assert_eq!(sector_of(0.01), SECTORS / 2);
        assert_eq!(sector_of(PI - 1e-9), SECTORS - 1);
        assert_eq!(sector_of(0.01 + 3.0 * TAU), SECTORS / 2);
        assert!([f64::NAN, f64::INFINITY, -1e300, 1e300].map(sector_of).into_iter().all(|s| s < SECTORS));
    }

    #[test]
    fn a_dropout_changes_its_own_sector_only() {
        let mut ranges: Vec<f32> = (0..180_u8).map(|i| 1.0 + f32::from(i) * 0.01).collect();
        let describe =
            |ranges: &[f32]| Description::of(ScanBuffer::from_ranges(ranges, -1.55, 0.0174).view().unwrap());
        let before = describe(&ranges);
        ranges[90] = f32::INFINITY;
        let after = describe(&ranges);
        let changed =
            (0..SECTORS).filter(|i| before.profile_m[*i].to_bits() != after.profile_m[*i].to_bits()).count();
        assert_eq!((changed, before.valid, after.valid), (1, 180, 179));
        assert!((after.histogram.iter().sum::<f32>() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_scan_without_returns_is_described() {
        let empty = Description::of(ScanBuffer::from_ranges(&[], 0.0, 0.1).view().unwrap());
        assert!(empty.valid == 0 && empty.profile_m.iter().all(|m| m.is_nan()));
        assert!(empty.histogram.iter().all(|share| *share == 0.0));
    }
}
