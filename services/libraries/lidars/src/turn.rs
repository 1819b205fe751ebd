//! One turn of a lidar.

use flockslam_messages::{ScanBuffer, ScanSections};

/// The beams of one turn, in the order in which they were measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Turn {
    /// When the first beam was measured, nanoseconds in the clock of the arrivals.
    pub begun_ns: i64,
    /// Turns a second.
    pub speed_hz: f64,
    /// Ranges, metres; 0 where nothing returned.
    pub ranges_m: Vec<f32>,
    /// Directions in the frame of the lidar, radians counter-clockwise as seen from above (REP-103).
    pub angles_rad: Vec<f32>,
    /// Strengths of the returns as the lidar gives them; empty when it gives none.
    pub intensities: Vec<f32>,
    /// When each beam was measured, seconds after the first.
    pub times_s: Vec<f32>,
    /// Ranges below are no returns, metres.
    pub range_min_m: f32,
    /// Ranges above are no returns, metres.
    pub range_max_m: f32,
}

impl Turn {
    /// Number of beams.
    pub fn len(&self) -> usize {
        self.ranges_m.len()
    }

    /// Whether it has no beams.
    pub fn is_empty(&self) -> bool {
        self.ranges_m.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.ranges_m.clear();
        self.angles_rad.clear();
        self.intensities.clear();
        self.times_s.clear();
    }

    /// Writes the turn as a scan, without name, place and odometry.
    pub fn write_scan(&self, scan: &mut ScanBuffer) {
        let header = &mut scan.header;
        header.times.sensor_ns = self.begun_ns;
        header.beam_count = self.len() as u32;
        let (first, last) = (self.angles_rad.first(), self.angles_rad.last());
        let step = |first: f32, last: f32| f64::from(last - first) / (self.len() - 1).max(1) as f64;
        header.angle_min_rad = first.copied().map_or(0.0, f64::from);
        header.angle_increment_rad = first.zip(last).map_or(0.0, |(first, last)| step(*first, *last));
        header.time_increment_s =
            self.times_s.last().map_or(0.0, |last| last / (self.len() - 1).max(1) as f32);
        (header.range_min_m, header.range_max_m) = (self.range_min_m, self.range_max_m);
        header.sections = ScanSections::ANGLES | ScanSections::TIMES;
        scan.numbers.clear();
        scan.numbers.extend_from_slice(&self.ranges_m);
        scan.numbers.extend_from_slice(&self.angles_rad);
        if !self.intensities.is_empty() {
            scan.header.sections |= ScanSections::INTENSITIES;
            scan.numbers.extend_from_slice(&self.intensities);
        }
        scan.numbers.extend_from_slice(&self.times_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_is_a_scan_with_angles_and_times_of_its_own() {
        let turn = Turn {
            begun_ns: 7,
            speed_hz: 10.0,
            ranges_m: vec![1.0, 0.0, 3.0],
            angles_rad: vec![0.0, -0.1, -0.25],
            intensities: vec![9.0, 0.0, 8.0],
            times_s: vec![0.0, 0.001, 0.002],
            range_min_m: 0.02,
            range_max_m: 12.0,
        };
        let mut scan = ScanBuffer::default();
        turn.write_scan(&mut scan);
        let view = scan.view().unwrap();
        assert_eq!((view.len(), view.angle_rad(2), view.valid_range_m(1)), (3, -0.25, None));
        assert_eq!((view.intensities(), view.takes_time()), (Some(&[9.0, 0.0, 8.0][..]), true));
        assert!((view.time_s(2) - 0.002).abs() < 1e-9);
        // A turn without intensities into the same buffer.
        Turn { intensities: Vec::new(), ..turn }.write_scan(&mut scan);
        assert_eq!(scan.view().unwrap().intensities(), None);
    }
}
