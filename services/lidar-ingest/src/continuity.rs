//! Rejects scans that do not follow the ones before them: old stamps, and repeated ranges of a robot that moves.

use crate::carmen::Rejection;
use flockslam_geometry::Pose;
use flockslam_messages::{ScanBuffer, ScanView};

/// Stamps of scans in their order may run backwards by this much: recorders stamp on arrival.
const REVERSED_NS: i64 = 2_000_000_000;
/// Motion of odometry during which no lidar sees the very same, metres and radians.
const MOVED: (f64, f64) = (0.02, 0.02);
/// Valid ranges that must be the same for a scan to be a repetition.
const SAME_MIN: usize = 10;

/// Whether a stamp may follow another one, nanoseconds: it is not far behind.
pub fn follows(stamp_ns: i64, before_ns: i64) -> bool {
    before_ns.saturating_sub(stamp_ns) <= REVERSED_NS
}

/// Compares each scan with the one before it: time must go on, and a moving robot must see something else.
#[derive(Debug, Default)]
pub struct Continuity {
    /// Stamp of the last scan that was not refused for it.
    last_ns: Option<i64>,
    /// Stamp of the last scan, when it was refused for its stamp.
    refused_ns: Option<i64>,
    /// By how much time has gone back at the last scan, nanoseconds; 0 where it has not.
    back_ns: i64,
    ranges: Vec<f32>,
    odometry: Option<Pose>,
}

impl Continuity {
    /// The reason to reject the next scan, if there is one.
    ///
    /// A scan that is stamped far behind the one before it is an old one. When the next one follows it, though, the clock was put back,
    /// and time goes on from there. A scan with exactly the ranges of the last one that was taken, while odometry has turned,
    /// comes from a driver that repeats itself.
    pub fn refuses(&mut self, scan: &ScanBuffer) -> Option<Rejection> {
        let view = scan.view().ok()?;
        let stamp_ns = view.header().times.sensor_ns;
        if self.is_old(stamp_ns) {
            self.refused_ns = Some(stamp_ns);
            return Some(Rejection::TimeReversed);
        }
        self.refused_ns = None;
        let before_ns = self.last_ns.replace(stamp_ns);
        let back_ns = before_ns.map_or(0, |before_ns| before_ns.saturating_sub(stamp_ns));
        self.back_ns = if back_ns > REVERSED_NS { back_ns } else { 0 };
        if self.is_frozen(view) {
            return Some(Rejection::Frozen);
        }
        self.keep(view);
        None
    }

    /// By how much time has gone back at the last scan that was not refused for its stamp, nanoseconds; `None` where it has not.
    pub fn back_ns(&self) -> Option<i64> {
        (self.back_ns > 0).then_some(self.back_ns)
    }

    fn is_old(&self, stamp_ns: i64) -> bool {
        let is_behind = self.last_ns.is_some_and(|last_ns| !follows(stamp_ns, last_ns));
        let goes_on =
            self.refused_ns.is_some_and(|refused_ns| stamp_ns.abs_diff(refused_ns) < REVERSED_NS as u64);
        is_behind && !goes_on
    }

    fn is_frozen(&self, view: ScanView<'_>) -> bool {
        let moved = match (self.odometry, view.odometry()) {
            (Some(before), Some(now)) => before.distance_m(now) > MOVED.0 || before.turn_rad(now) > MOVED.1,
            _ => false,
        };
        let same = || (0..view.len()).filter(|beam| view.valid_range_m(*beam).is_some()).count() >= SAME_MIN;
        let is_same = |(before, now): (&f32, &f32)| before.to_bits() == now.to_bits();
        moved
            && self.ranges.len() == view.len()
            && self.ranges.iter().zip(view.ranges()).all(is_same)
            && same()
    }

    fn keep(&mut self, view: ScanView<'_>) {
        self.ranges.clear();
        self.ranges.extend_from_slice(view.ranges());
        self.odometry = view.odometry();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scan at this time, metre of the way, and range.
    fn scan(stamp_s: f64, way_m: f64, range_m: f32) -> ScanBuffer {
        let mut scan = ScanBuffer::from_ranges(&[range_m; 20], -1.0, 1.0);
        scan.header.times.sensor_ns = (stamp_s * 1e9) as i64;
        (scan.header.odometry, scan.header.has_odometry) = (Pose::new(way_m, 0.0, 0.0), 1);
        scan
    }

    fn rejections(scans: &[ScanBuffer]) -> Vec<Option<Rejection>> {
        let mut continuity = Continuity::default();
        scans.iter().map(|scan| continuity.refuses(scan)).collect()
    }

    #[test]
    fn an_old_scan_is_refused_and_a_clock_put_back_is_not() {
        let late = [scan(10.0, 0.0, 1.0), scan(9.2, 0.1, 1.1), scan(3.0, 0.2, 1.2), scan(10.1, 0.3, 1.3)];
        assert_eq!(rejections(&late), [None, None, Some(Rejection::TimeReversed), None]);
        let put_back = [scan(10.0, 0.0, 1.0), scan(3.0, 0.1, 1.1), scan(3.1, 0.2, 1.2), scan(3.2, 0.3, 1.3)];
        assert_eq!(rejections(&put_back), [None, Some(Rejection::TimeReversed), None, None]);
        let mut continuity = Continuity::default();
        let back_ns = put_back.each_ref().map(|scan| {
            continuity.refuses(scan);
            continuity.back_ns()
        });
        assert_eq!(back_ns, [None, None, Some(6_900_000_000), None]);
    }

    #[test]
    fn equal_ranges_during_motion_are_rejected_as_frozen() {
        let frozen = [scan(1.0, 0.0, 1.0), scan(1.1, 0.1, 1.0), scan(1.2, 0.2, 1.0), scan(1.3, 0.3, 1.1)];
        assert_eq!(rejections(&frozen), [None, Some(Rejection::Frozen), Some(Rejection::Frozen), None]);
        let standing = [scan(1.0, 0.0, 1.0), scan(1.1, 0.0, 1.0), scan(1.2, 0.001, 1.0)];
        assert_eq!(rejections(&standing), [None; 3]);
    }
}
