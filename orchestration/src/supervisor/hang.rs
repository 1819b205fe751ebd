//! Decides whether a process hangs. Takes its last heartbeat and the time; reads no clock.

use flockslam_telemetry::Beat;
use std::time::Duration;

/// A process that starts, or recovers what its predecessor knew, hangs after so long without a sign of life: reading a long journal
/// is one call.
const START_LIMIT: Duration = Duration::from_secs(10);
/// A supervisor that was itself held up for longer than this between two looks waits for another: the whole machine may have stood
/// still, and everybody deserves a chance to speak first.
const OWN_DELAY_MAX: Duration = Duration::from_millis(250);

/// Tells a process that hangs (stopped, or in an endless loop) from one that works, by its signs of life on the monotonic clock.
#[derive(Debug, Default)]
pub struct HangWatch {
    looked_ns: Option<u64>,
}

impl HangWatch {
    /// To be called at each look, before the heartbeats are checked; false when it is too early for a check.
    pub fn look(&mut self, now_ns: u64) -> bool {
        let before = self.looked_ns.replace(now_ns);
        before.is_some_and(|before| now_ns.saturating_sub(before) <= OWN_DELAY_MAX.as_nanos() as u64)
    }
}

/// Whether a process that was started at `started_ns` and last gave this sign of life hangs at `now_ns`.
pub fn hangs(beat: Option<Beat>, started_ns: u64, now_ns: u64, deadline: Duration) -> bool {
    let (since_ns, limit) = match beat {
        Some(beat) if beat.ready => (beat.monotonic_ns, deadline),
        Some(beat) => (beat.monotonic_ns, START_LIMIT.max(deadline)),
        None => (started_ns, START_LIMIT.max(deadline)),
    };
    now_ns.saturating_sub(since_ns) > limit.as_nanos() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn silence_past_the_deadline_is_a_hang_and_a_start_has_more_time() {
        let beat = Some(Beat {
            pid: 1,
            ready: true,
            monotonic_ns: 1000 * MS,
            handled: 0,
            works: false,
            durable: true,
        });
        let deadline = Duration::from_millis(500);
        assert!(!hangs(beat, 0, 1500 * MS, deadline));
        assert!(hangs(beat, 0, 1501 * MS, deadline));
        let recovers = beat.map(|beat| Beat { ready: false, ..beat });
        assert!(!hangs(recovers, 0, 9_000 * MS, deadline) && hangs(recovers, 0, 11_001 * MS, deadline));
        assert!(!hangs(None, 0, 9_000 * MS, deadline));
        assert!(hangs(None, 0, 10_001 * MS, deadline));
        assert!(!hangs(beat, 0, 0, deadline), "a beat of the future is none too old");
    }

    #[test]
    fn no_stage_counts_as_hung_after_the_supervisor_was_delayed() {
        let mut watch = HangWatch::default();
        assert!(!watch.look(0), "nothing is known at the first look");
        assert!(watch.look(100 * MS));
        assert!(!watch.look(5_000 * MS) && watch.look(5_100 * MS));
    }
}
