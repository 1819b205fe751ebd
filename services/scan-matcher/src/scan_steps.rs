//! The time from scan to scan, by stamps that may jitter, repeat, or be given in batches.

use flockslam_messages::{PoseEstimate, ScanView};

/// Seconds between scans, assumed before two stamps are known and for steps that are not positive.
const PERIOD_START_S: f64 = 0.1;
/// Weight of the newest step in the running means.
const RATE: f64 = 0.05;
/// Longest step between stamps that is accepted, seconds.
pub(crate) const PERIOD_MAX_S: f64 = 2.0;
/// A step below this share of the period is far too short for a lidar.
const SHORT: f64 = 0.2;
/// Where more than this share of steps are far too short, a computer stamped the scans as it received them, several at once: only their
/// mean step is that of the lidar.
const BATCHED: f64 = 0.2;

/// Stamp, number and lidar of the last scan, and what the steps so far show.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanSteps {
    stamp_ns: Option<i64>,
    sequence: Option<u64>,
    lidar: u32,
    period_s: f64,
    /// Running share of steps that are far too short.
    short: f64,
    /// Scans in a row with the same stamp as the one before.
    repeated: u32,
}

impl Default for ScanSteps {
    fn default() -> Self {
        Self { stamp_ns: None, sequence: None, lidar: 0, period_s: PERIOD_START_S, short: 0.0, repeated: 0 }
    }
}

impl ScanSteps {
    /// After a pose of which nothing but the stamp is known to be near.
    pub(crate) fn stamped(last: &PoseEstimate) -> Self {
        Self { stamp_ns: Some(last.times.sensor_ns), ..Self::default() }
    }

    /// After the scan of a published pose; the period stays.
    pub(crate) fn resumed(&self, last: &PoseEstimate) -> Self {
        let (stamp_ns, sequence) = (Some(last.times.sensor_ns), Some(last.id.sequence));
        Self { stamp_ns, sequence, lidar: last.id.lidar, ..*self }
    }

    /// Takes in when a predecessor's scan was taken, before [`Self::resumed`].
    pub(crate) fn restore(&mut self, published: &PoseEstimate) {
        let (stamp_ns, sequence) = (published.times.sensor_ns, published.id.sequence);
        let is_next = self.sequence.is_some_and(|before| before.checked_add(1) == Some(sequence));
        let elapsed_s = self.stamp_ns.map(|before| stamp_ns.saturating_sub(before) as f64 * 1e-9);
        if let Some(step_s) = elapsed_s.filter(|step_s| is_next && (0.0..=PERIOD_MAX_S).contains(step_s)) {
            self.learn(step_s);
        }
        (self.stamp_ns, self.sequence) = (Some(stamp_ns), Some(sequence));
    }

    /// Nothing connects the next scan with the last one; the period stays.
    pub(crate) fn break_off(&mut self) {
        (self.stamp_ns, self.sequence) = (None, None);
    }

    /// Whether there was a scan before.
    pub(crate) fn has_begun(&self) -> bool {
        self.stamp_ns.is_some()
    }

    /// Seconds since the scan before; the nominal period when the stamps of a lidar do not step forward.
    pub(crate) fn step_s(&self, scan: ScanView<'_>) -> f64 {
        let Some(step_s) = self.elapsed_s(scan) else { return self.period_s };
        let is_forward = step_s > 0.0 || (step_s == 0.0 && self.is_of_another(scan));
        let longest_s = PERIOD_MAX_S.max(self.longest_s(scan));
        if is_forward && step_s <= longest_s { step_s } else { self.period_s }
    }

    /// Seconds since the scan before, by the stamps.
    pub(crate) fn elapsed_s(&self, scan: ScanView<'_>) -> Option<f64> {
        self.stamp_ns.map(|before| scan.header().times.sensor_ns.saturating_sub(before) as f64 * 1e-9)
    }

    /// A step between stamps that jitter, kept near the nominal period: scans of a lidar come at even times even if their stamps do
    /// not, and a velocity over a step far too short would be far too great.
    pub(crate) fn even_s(&self, scan: ScanView<'_>, step_s: f64) -> f64 {
        let longest_s = self.longest_s(scan);
        if self.is_of_another(scan) {
            return step_s.min(longest_s);
        }
        if self.short > BATCHED {
            return longest_s - self.period_s;
        }
        step_s.clamp(0.5 * self.period_s, longest_s)
    }

    /// How many scans were lost between the one before and this one.
    pub(crate) fn missing(&self, scan: ScanView<'_>) -> u64 {
        let sequence = scan.header().id.sequence;
        self.sequence.map_or(0, |before| sequence.saturating_sub(before.saturating_add(1)))
    }

    /// Whether a scan is of another lidar than the one before.
    pub(crate) fn is_of_another(&self, scan: ScanView<'_>) -> bool {
        self.has_begun() && scan.header().id.lidar != self.lidar
    }

    /// Whether a scan of another lidar is so near in time that the two do not show a velocity.
    pub(crate) fn is_brief(&self, scan: ScanView<'_>, step_s: f64) -> bool {
        self.is_of_another(scan) && step_s < 0.5 * self.period_s
    }

    /// Counts the time since the scan before, which goes on from there by [`Self::advance`].
    pub(crate) fn count(&mut self, scan: ScanView<'_>, step_s: f64) {
        let is_repeated = self.elapsed_s(scan) == Some(0.0) && !self.is_of_another(scan);
        self.learn(if is_repeated { 0.0 } else { step_s });
    }

    /// The next scan is counted from this one.
    pub(crate) fn advance(&mut self, scan: ScanView<'_>) {
        let header = scan.header();
        (self.stamp_ns, self.sequence) = (Some(header.times.sensor_ns), Some(header.id.sequence));
        self.lidar = header.id.lidar;
    }

    /// Mean seconds from scan to scan.
    #[cfg(test)]
    pub(crate) fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Takes a step into the means, seconds. Scans with one stamp share the step to the next stamp; stamps that never step leave the period
    /// as it is.
    fn learn(&mut self, step_s: f64) {
        self.short += RATE * (f64::from(step_s < SHORT * self.period_s) - self.short);
        if step_s == 0.0 {
            self.repeated = self.repeated.saturating_add(1);
            return;
        }
        let scans = 1.0 + f64::from(self.repeated);
        self.period_s += (RATE * scans).min(0.5) * (step_s / scans - self.period_s);
        self.repeated = 0;
    }

    /// The longest step since the scan before that is even, seconds: scans that were lost on the way here have taken their time.
    fn longest_s(&self, scan: ScanView<'_>) -> f64 {
        (2.0 + self.missing(scan) as f64) * self.period_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::ScanBuffer;

    /// Counts scans with these stamps, and gives the steps that a velocity is taken over.
    fn counted(steps: &mut ScanSteps, stamps_s: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut even_s = Vec::new();
        for (number, stamp_s) in (1..).zip(stamps_s) {
            let mut scan = ScanBuffer::from_ranges(&[2.0; 9], -1.0, 0.25);
            (scan.header.id.sequence, scan.header.times.sensor_ns) = (number, (1e9 * stamp_s) as i64);
            let scan = scan.view().unwrap();
            let step_s = steps.step_s(scan);
            even_s.push(steps.even_s(scan, step_s));
            if steps.has_begun() {
                steps.count(scan, step_s);
            }
            steps.advance(scan);
        }
        even_s
    }

    #[test]
    fn scans_that_are_stamped_three_at_a_time_come_at_even_times() {
        let mut steps = ScanSteps::default();
        let even_s = counted(&mut steps, (0..300).map(|i| 0.6 * f64::from(i / 3)));
        assert!(even_s[200..].iter().all(|step_s| (step_s - 0.2).abs() < 0.05), "{:?}", &even_s[290..]);
    }

    #[test]
    fn a_lidar_that_slows_down_is_followed_by_its_stamps() {
        let mut steps = ScanSteps::default();
        let even_s = counted(&mut steps, (0..100).map(|i| 0.15 * f64::from(i)));
        assert!(even_s[1..].iter().all(|step_s| (step_s - 0.15).abs() < 1e-6), "{even_s:?}");
    }

    #[test]
    fn stamps_that_stand_still_leave_the_period() {
        let mut steps = ScanSteps::default();
        let even_s = counted(&mut steps, std::iter::repeat_n(7.0, 500));
        assert!(even_s.iter().all(|step_s| *step_s == PERIOD_START_S), "{even_s:?}");
    }
}
