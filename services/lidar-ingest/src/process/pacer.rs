//! When a scan of a live replay is due on the monotonic clock.

use std::time::Duration;

/// Where a live replay hangs on the monotonic clock; kept outside the process, so that a restart goes on in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Anchor {
    /// CLOCK_MONOTONIC at the first scan, nanoseconds.
    pub monotonic_ns: u64,
    /// Stamp of the first scan, nanoseconds.
    pub stamp_ns: i64,
}

/// Paces a replay by the highest stamp so far: a stamp that runs backwards is due at once.
#[derive(Debug)]
pub struct Pacer {
    rate: f64,
    anchor: Option<Anchor>,
    highest_ns: i64,
}

impl Pacer {
    /// Paces at `rate` log seconds per second, from `anchor` when there was one before.
    pub fn new(rate: f64, anchor: Option<Anchor>) -> Self {
        assert!(rate.is_finite() && rate > 0.0);
        Self { rate, anchor, highest_ns: i64::MIN }
    }

    /// Whether a scan with this stamp is due at `now_ns`.
    pub fn is_due(&mut self, stamp_ns: i64, now_ns: u64) -> bool {
        self.anchor.get_or_insert(Anchor { monotonic_ns: now_ns, stamp_ns });
        let due = self.wait(stamp_ns, now_ns).is_zero();
        if due {
            self.highest_ns = self.highest_ns.max(stamp_ns);
        }
        due
    }

    /// How long until it is due.
    pub fn wait(&self, stamp_ns: i64, now_ns: u64) -> Duration {
        let Some(anchor) = self.anchor else { return Duration::ZERO };
        let since_start_ns =
            (stamp_ns.max(self.highest_ns).saturating_sub(anchor.stamp_ns)) as f64 / self.rate;
        let due_ns = anchor.monotonic_ns as f64 + since_start_ns.max(0.0);
        Duration::from_nanos((due_ns - now_ns as f64).max(0.0) as u64)
    }

    /// The next scan is due at once, and those after it by their distance to it.
    pub fn begin_anew(&mut self) {
        self.anchor = None;
    }

    /// The anchor, once the first scan was due.
    pub fn anchor(&self) -> Option<Anchor> {
        self.anchor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_stamp_sets_the_pace() {
        let mut pacer = Pacer::new(2.0, None);
        assert!(pacer.is_due(1_000, 50));
        assert!(!pacer.is_due(2_000, 549) && pacer.is_due(2_000, 550));
        assert!(pacer.is_due(1_500, 550), "a stamp that runs backwards waits for nothing");
        assert_eq!(pacer.wait(3_000, 600), Duration::from_nanos(450));
        let resumed = Pacer::new(2.0, pacer.anchor());
        assert_eq!(resumed.wait(3_000, 600), Duration::from_nanos(450));
    }
}
