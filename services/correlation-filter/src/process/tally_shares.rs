//! A large scan described by several threads of several processes.

use crate::tally::tally;
use flockslam_messages::{LARGE_SCAN_BEAMS, ScanTally, ScanView};
use std::ops::Range;

/// A thread takes at least so many beams: starting one takes as long as describing about as many.
const BEAMS_PER_THREAD: usize = 100_000;

/// Whether the replicas share the beams of this scan.
pub(super) fn is_shared(scan: ScanView<'_>, replicas: u32) -> bool {
    replicas > 1 && scan.len() > LARGE_SCAN_BEAMS
}

/// The beams of one part.
fn beams_of_part(beams: usize, part: u32, parts: u32) -> Range<usize> {
    let bound = |part: u32| (beams as u64 * u64::from(part) / u64::from(parts)) as usize;
    bound(part)..bound(part + 1)
}

/// The tally of one of `parts` equal parts of a scan, read in place by up to so many threads.
pub fn tally_part(scan: ScanView<'_>, part: u32, parts: u32, threads: usize) -> ScanTally {
    let beams = beams_of_part(scan.len(), part, parts);
    let threads = (beams.len() / BEAMS_PER_THREAD).clamp(1, threads.max(1)) as u32;
    let slice = |thread: u32| {
        let within = beams_of_part(beams.len(), thread, threads);
        tally(scan, beams.start + within.start..beams.start + within.end)
    };
    let mut sum = if threads == 1 { slice(0) } else { together(threads, slice) };
    (sum.part, sum.parts) = (part, parts);
    sum
}

/// The sum of the slices of so many threads, of which this is the first.
fn together(threads: u32, slice: impl Fn(u32) -> ScanTally + Sync) -> ScanTally {
    let slice = &slice;
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|thread| scope.spawn(move || slice(thread))).collect();
        let own = slice(0);
        others.into_iter().fold(own, |mut sum, other| {
            sum.add(&other.join().expect("a thread that only adds does not panic"));
            sum
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;
    use proptest::prelude::*;

    fn scan(beams: usize) -> ScanBuffer {
        let ranges: Vec<f32> = (0..beams).map(|i| 1.0 + (i * 7919 % 1000) as f32 * 0.01).collect();
        let mut scan = ScanBuffer::from_ranges(&ranges, -3.0, 6.0 / beams as f64);
        scan.header.id.sequence = 5;
        scan
    }

    #[test]
    fn parts_of_threads_and_replicas_are_the_whole() {
        let scan = scan(450_001);
        let view = scan.view().unwrap();
        let whole = tally(view, 0..view.len());
        let mut sum = tally_part(view, 0, 3, 4);
        (1..3).rev().for_each(|part| sum.add(&tally_part(view, part, 3, 2)));
        sum.parts = 1;
        assert_eq!(sum, whole);
    }

    proptest! {
        #[test]
        fn parts_cover_all_beams_once(beams in 0_usize..20_000_000, parts in 1_u32..9) {
            let ranges: Vec<_> = (0..parts).map(|part| beams_of_part(beams, part, parts)).collect();
            prop_assert_eq!((ranges[0].start, ranges[ranges.len() - 1].end), (0, beams));
            prop_assert!(ranges.windows(2).all(|pair| pair[0].end == pair[1].start));
        }
    }
}
