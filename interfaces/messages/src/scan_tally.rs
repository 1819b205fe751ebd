//! The message of the sums over the beams of a scan: parts of a large scan add up to the whole exactly.

use crate::ScanId;
use crate::message::message;

/// Sectors of the full circle in a [`ScanTally`]: 6° each, so half a circle has the 30 of An. Filatov's program.
pub const TALLY_SECTORS: usize = 60;
/// Bins of ranges in a [`ScanTally`].
pub const TALLY_BINS: usize = 30;

message! {
    /// The sums of some or all beams of a scan. All numbers are integers, so the tallies of the parts of a scan sum up to
    /// exactly the tally of the whole, in any order: replicas of the filter exchange them for large scans.
    #[derive(Eq)]
    pub struct ScanTally = "flockslam/scan-tally/v1" {
        /// The scan.
        pub id: ScanId,
        /// Sum of `sgn(r_i − r_{i+1})` over neighbouring valid beams, with the sign that each has along a corridor.
        pub corridor: i64,
        /// Number of neighbouring valid beams.
        pub pairs: u64,
        /// Sum of the valid ranges in each sector, 1/1024 m.
        pub range_sums: [u64; TALLY_SECTORS],
        /// Valid ranges in each sector.
        pub counts: [u32; TALLY_SECTORS],
        /// Valid ranges in each bin; of a large scan those of every 16th beam.
        pub bins: [u32; TALLY_BINS],
        /// Which part of the scan, from 0.
        pub part: u32,
        /// Number of parts.
        pub parts: u32,
    }
}

impl ScanTally {
    /// Takes in the beams of another part of the same scan.
    pub fn add(&mut self, other: &Self) {
        self.corridor += other.corridor;
        self.pairs += other.pairs;
        self.range_sums.iter_mut().zip(&other.range_sums).for_each(|(a, b)| *a += b);
        self.counts.iter_mut().zip(&other.counts).for_each(|(a, b)| *a += b);
        self.bins.iter_mut().zip(&other.bins).for_each(|(a, b)| *a += b);
    }

    /// Number of valid ranges.
    pub fn valid(&self) -> u32 {
        self.counts.iter().sum()
    }
}
