//! A histogram of durations with a bounded relative error, of fixed size, that can be merged and sent.

use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// Buckets per octave: a bucket is at most 1/32 of its value wide, its middle at most 1/64 off.
const PER_OCTAVE: usize = 32;
/// Below this every nanosecond has a bucket of its own.
const LINEAR_NS: u64 = 64;
/// Octaves above `LINEAR_NS`: up to 2³⁷ ns = 137 s.
const OCTAVES: usize = 31;
const BUCKETS: usize = LINEAR_NS as usize + OCTAVES * PER_OCTAVE;
const LIMIT_NS: u64 = LINEAR_NS << OCTAVES;

/// Counts durations in log-linear buckets (1 ns … 137 s, read-outs within 1.6 %): a fixed array of plain data that is
/// recorded without allocation, merged by adding and encoded as its bytes.
///
/// ```
/// use flockslam_telemetry::LatencyHistogram;
///
/// let mut histogram = LatencyHistogram::default();
/// (1..=100_u64).for_each(|ms| histogram.record(ms * 1_000_000));
/// let figures = histogram.quantiles();
/// assert_eq!((figures.count, figures.max_ns), (100, 100_000_000));
/// assert!(figures.p50_ns.abs_diff(50_000_000) < 1_000_000);
///
/// let mut both = LatencyHistogram::from_bytes(histogram.as_bytes()).expect("its own bytes");
/// both.merge(&histogram);
/// assert_eq!(both.count(), 200);
/// ```
#[repr(C)]
#[derive(Clone, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct LatencyHistogram {
    counts: [u64; BUCKETS],
    count: u64,
    max_ns: u64,
}

/// The figures of a report, nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LatencyQuantiles {
    /// Durations recorded.
    pub count: u64,
    /// Median.
    pub p50_ns: u64,
    /// 99 of 100 are at most this.
    pub p99_ns: u64,
    /// The longest, exact.
    pub max_ns: u64,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self::new_zeroed()
    }
}

impl LatencyHistogram {
    /// Adds one duration; longer ones than 137 s are counted as 137 s (the maximum stays exact).
    pub fn record(&mut self, duration_ns: u64) {
        self.counts[bucket_of(duration_ns)] += 1;
        self.count += 1;
        self.max_ns = self.max_ns.max(duration_ns);
    }

    /// Adds all durations of another histogram.
    pub fn merge(&mut self, other: &LatencyHistogram) {
        for (mine, theirs) in self.counts.iter_mut().zip(&other.counts) {
            *mine = mine.saturating_add(*theirs);
        }
        self.count = self.count.saturating_add(other.count);
        self.max_ns = self.max_ns.max(other.max_ns);
    }

    /// Durations recorded.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The longest duration, exact; 0 when empty.
    pub fn max_ns(&self) -> u64 {
        self.max_ns
    }

    /// The duration that a share `q` (0 … 1) of all does not exceed, nanoseconds; 0 when empty.
    pub fn quantile_ns(&self, q: f64) -> u64 {
        let rank = ((q.clamp(0.0, 1.0) * self.count as f64).ceil() as u64).max(1);
        let mut seen = 0_u64;
        for (bucket, count) in self.counts.iter().enumerate() {
            seen = seen.saturating_add(*count);
            if seen >= rank {
                return middle_ns(bucket).min(self.max_ns);
            }
        }
        self.max_ns
    }

    /// Count, median, 99th percentile and maximum.
    pub fn quantiles(&self) -> LatencyQuantiles {
        LatencyQuantiles {
            count: self.count,
            p50_ns: self.quantile_ns(0.5),
            p99_ns: self.quantile_ns(0.99),
            max_ns: self.max_ns,
        }
    }

    /// The histogram as bytes, for a file or a message.
    pub fn as_bytes(&self) -> &[u8] {
        IntoBytes::as_bytes(self)
    }

    /// A histogram from [`Self::as_bytes`]; `None` when the bytes are not one.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let histogram = Self::read_from_bytes(bytes).ok()?;
        let total = histogram.counts.iter().try_fold(0_u64, |sum, count| sum.checked_add(*count))?;
        (total == histogram.count).then_some(histogram)
    }
}

fn bucket_of(duration_ns: u64) -> usize {
    let value = duration_ns.min(LIMIT_NS - 1);
    if value < LINEAR_NS {
        return value as usize;
    }
    let octave = (value.ilog2() - LINEAR_NS.ilog2()) as usize;
    let within = (value >> (octave + 1)) as usize - PER_OCTAVE;
    LINEAR_NS as usize + octave * PER_OCTAVE + within
}

fn middle_ns(bucket: usize) -> u64 {
    let Some(beyond) = bucket.checked_sub(LINEAR_NS as usize) else { return bucket as u64 };
    let (octave, within) = (beyond / PER_OCTAVE, beyond % PER_OCTAVE);
    let width = 1_u64 << (octave + 1);
    (PER_OCTAVE + within) as u64 * width + width / 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_bucket_stands_for_its_values_within_two_percent(value in 1_u64..100_000_000_000) {
            let middle = middle_ns(bucket_of(value));
            prop_assert!((middle as f64 - value as f64).abs() <= 0.016 * value as f64, "{value} -> {middle}");
        }

        #[test]
        fn quantiles_agree_with_the_sorted_values(
            mut values in prop::collection::vec(100_u64..100_000_000_000, 1..400), q in 0.0..1.0_f64,
        ) {
            let mut histogram = LatencyHistogram::default();
            values.iter().for_each(|value| histogram.record(*value));
            values.sort_unstable();
            let rank = ((q * values.len() as f64).ceil() as usize).clamp(1, values.len());
            let (exact, read) = (values[rank - 1] as f64, histogram.quantile_ns(q) as f64);
            prop_assert!((read - exact).abs() <= 0.016 * exact, "{exact} -> {read}");
            prop_assert_eq!(histogram.max_ns(), *values.last().unwrap());
        }

        #[test]
        fn merging_is_recording_both(
            first in prop::collection::vec(any::<u64>(), 0..50), second in prop::collection::vec(any::<u64>(), 0..50),
        ) {
            let recorded = |values: &[u64]| {
                let mut histogram = LatencyHistogram::default();
                values.iter().for_each(|value| histogram.record(*value));
                histogram
            };
            let mut merged = recorded(&first);
            merged.merge(&recorded(&second));
            prop_assert_eq!(&merged, &recorded(&[first, second].concat()));
            prop_assert_eq!(LatencyHistogram::from_bytes(merged.as_bytes()), Some(merged));
        }
    }

    #[test]
    fn buckets_are_contiguous() {
        let mut expected = 0;
        for value in 0..1_u64 << 20 {
            let bucket = bucket_of(value);
            assert!(bucket == expected || bucket == expected + 1, "{value}");
            expected = bucket;
        }
        assert_eq!(bucket_of(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn an_empty_histogram_and_foreign_bytes_are_defined() {
        assert_eq!(LatencyHistogram::default().quantiles(), LatencyQuantiles::default());
        assert_eq!(LatencyHistogram::from_bytes(&[1; 100]), None);
        assert_eq!(LatencyHistogram::from_bytes(&vec![1; size_of::<LatencyHistogram>()]), None);
        assert_eq!(LatencyHistogram::from_bytes(&vec![255; size_of::<LatencyHistogram>()]), None);
    }
}
