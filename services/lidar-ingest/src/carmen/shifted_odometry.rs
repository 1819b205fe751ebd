//! Odometry of a log at the times that its scans have by the clock of odometry.

use super::{CarmenReader, ReadError};
use flockslam_geometry::Pose;
use flockslam_messages::ScanBuffer;
use std::collections::VecDeque;
use std::io::BufRead;

/// Scans of a log, each with the odometry of its stamp and an offset. A line of a log has odometry as old as it was when the scan arrived:
/// the lines around say what it was at another time.
#[derive(Debug)]
pub struct ShiftedOdometry {
    offset_ns: i64,
    /// Scans whose odometry is not known yet, in order.
    waiting: VecDeque<ScanBuffer>,
    /// Stamps and odometry of the lines around those, in order of the stamps.
    poses: VecDeque<(i64, Pose)>,
    /// Memory for scans.
    spare: Vec<ScanBuffer>,
    has_ended: bool,
}

impl ShiftedOdometry {
    /// With an offset that is added to stamps, nanoseconds.
    pub fn new(offset_ns: i64) -> Self {
        Self {
            offset_ns,
            waiting: VecDeque::new(),
            poses: VecDeque::new(),
            spare: Vec::new(),
            has_ended: false,
        }
    }

    /// Reads the next scan; `false` at the end of the log.
    ///
    /// # Errors
    /// As [`CarmenReader::next_scan`] gives them.
    pub fn next_scan<R: BufRead>(
        &mut self,
        reader: &mut CarmenReader<R>,
        scan: &mut ScanBuffer,
    ) -> Result<bool, ReadError> {
        if self.offset_ns == 0 {
            return reader.next_scan(scan);
        }
        while !self.has_ended && !self.is_known() {
            let mut next = self.spare.pop().unwrap_or_default();
            if reader.next_scan(&mut next)? {
                self.take(next);
            } else {
                self.has_ended = true;
            }
        }
        let Some(mut first) = self.waiting.pop_front() else { return Ok(false) };
        if let Some(odometry) = self.odometry_at(self.asked_ns(&first)) {
            first.header.odometry = odometry;
        }
        self.forget(first.header.times.sensor_ns);
        std::mem::swap(scan, &mut first);
        self.spare.push(first);
        Ok(true)
    }

    /// The time at which the odometry of a scan is asked.
    fn asked_ns(&self, scan: &ScanBuffer) -> i64 {
        scan.header.times.sensor_ns.saturating_add(self.offset_ns)
    }

    /// Whether the lines so far reach the time of the first scan.
    fn is_known(&self) -> bool {
        let asked_ns = self.waiting.front().map(|first| self.asked_ns(first));
        asked_ns.is_some_and(|asked_ns| self.poses.back().is_some_and(|(last_ns, _)| *last_ns >= asked_ns))
    }

    fn take(&mut self, scan: ScanBuffer) {
        let stamp_ns = scan.header.times.sensor_ns;
        if self.poses.back().is_none_or(|(last_ns, _)| stamp_ns > *last_ns) {
            self.poses.push_back((stamp_ns, scan.header.odometry));
        }
        self.waiting.push_back(scan);
    }

    /// Odometry at this time, between the lines before and after; that of the first or the last line beyond them.
    fn odometry_at(&self, asked_ns: i64) -> Option<Pose> {
        let after = self.poses.partition_point(|(stamp_ns, _)| *stamp_ns < asked_ns);
        let Some((after_ns, to)) = self.poses.get(after) else {
            return self.poses.back().map(|(_, last)| *last);
        };
        let Some((before_ns, from)) = after.checked_sub(1).map(|before| self.poses[before]) else {
            return Some(*to);
        };
        let share = (asked_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
        Some(from.interpolate(*to, share))
    }

    /// Drops the lines that no scan after this one asks for.
    fn forget(&mut self, stamp_ns: i64) {
        let oldest_ns = stamp_ns.saturating_add(self.offset_ns.min(0));
        while self.poses.get(1).is_some_and(|(second_ns, _)| *second_ns <= oldest_ns) {
            self.poses.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use std::fmt::Write;

    /// Scans each 0.1 s of a robot that drives 0.05 m from one to the next by odometry.
    fn x_m_of(offset_ns: i64) -> Vec<f64> {
        let mut log = String::new();
        for i in 0..20 {
            let (x, stamp) = (0.05 * f64::from(i), 100.0 + 0.1 * f64::from(i));
            writeln!(log, "FLASER 3 1.0 1.1 1.2 {x} 0 0 {x} 0 0 {stamp} host {stamp}").unwrap();
        }
        let mut reader = CarmenReader::new(log.as_bytes(), "log", Settings::default());
        let mut shifted = ShiftedOdometry::new(offset_ns);
        let (mut scan, mut x_m) = (ScanBuffer::default(), Vec::new());
        while shifted.next_scan(&mut reader, &mut scan).unwrap() {
            assert_eq!(scan.header.id.sequence, x_m.len() as u64);
            x_m.push(scan.header.odometry.x_m);
        }
        x_m
    }

    #[test]
    fn odometry_is_that_of_the_time_asked_and_of_the_ends_of_the_log_beyond_them() {
        for (offset_ns, ahead_m) in [(0, 0.0), (150_000_000, 0.075), (-250_000_000, -0.125)] {
            let x_m = x_m_of(offset_ns);
            assert_eq!(x_m.len(), 20);
            for (i, x_m) in x_m.iter().enumerate() {
                let expected_m = (0.05 * i as f64 + ahead_m).clamp(0.0, 0.95);
                assert!((x_m - expected_m).abs() < 1e-6, "{offset_ns} {i}: {x_m}, not {expected_m}");
            }
        }
    }
}
