//! The time in the graph: that of the machine, or of a simulation.

use flockslam_telemetry::utc_ns;
use std::time::{Duration, Instant};

/// Time that goes back by less than this is a message that came out of order, nanoseconds.
const DISORDER_NS: i64 = 100_000_000;
/// What was on its way when time went back has come after this.
const ON_ITS_WAY: Duration = Duration::from_secs(1);

/// The time in the graph.
#[derive(Debug, Default)]
pub struct GraphClock {
    is_simulated: bool,
    /// What `/clock` said last, nanoseconds.
    received_ns: Option<i64>,
    /// The time from which it went back last, nanoseconds, and when that was.
    before: Option<(i64, Instant)>,
}

impl GraphClock {
    /// A clock that follows `/clock`, or the machine.
    pub fn new(is_simulated: bool) -> Self {
        Self { is_simulated, ..Self::default() }
    }

    /// Whether it follows `/clock`.
    pub fn is_simulated(&self) -> bool {
        self.is_simulated
    }

    /// Takes what `/clock` says; by how much time has gone back, nanoseconds, when it has.
    pub fn advance(&mut self, now_ns: i64) -> Option<i64> {
        let back_ns = self.received_ns.map_or(0, |before_ns| before_ns.saturating_sub(now_ns));
        if (1..DISORDER_NS).contains(&back_ns) {
            return None;
        }
        let before_ns = self.received_ns.replace(now_ns).filter(|_| self.is_simulated && back_ns > 0)?;
        self.before = Some((before_ns, Instant::now()));
        Some(back_ns)
    }

    /// Whether a stamp is of the time before the clock went back: what was on its way then still comes.
    pub fn is_of_before(&self, stamp_ns: i64) -> bool {
        let recent = self.before.filter(|(_, at)| at.elapsed() < ON_ITS_WAY);
        recent
            .zip(self.now_ns())
            .is_some_and(|((before_ns, _), now_ns)| stamp_ns.abs_diff(before_ns) < stamp_ns.abs_diff(now_ns))
    }

    /// The time to stamp what has no other, nanoseconds: that of the machine while a simulation has said none.
    pub fn stamp_ns(&self) -> i64 {
        self.now_ns().unwrap_or_else(utc_ns)
    }

    /// The time, nanoseconds; `None` before a simulation has said it.
    pub fn now_ns(&self) -> Option<i64> {
        if self.is_simulated { self.received_ns } else { Some(utc_ns()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn a_simulation_gives_the_time_and_may_restart() {
        let mut clock = GraphClock::new(true);
        assert_eq!(clock.now_ns(), None);
        let steps_back = [50, 70, 30].map(|now_s| clock.advance(now_s * SECOND));
        assert_eq!(steps_back, [None, None, Some(40 * SECOND)]);
        assert_eq!(clock.now_ns(), Some(30 * SECOND));
        assert!(clock.is_of_before(69 * SECOND) && !clock.is_of_before(31 * SECOND));
        // Two messages that come in the other order.
        assert_eq!(clock.advance(30 * SECOND - 1), None);
        assert_eq!(clock.now_ns(), Some(30 * SECOND));
        let mut machine = GraphClock::new(false);
        assert_eq!([50, 30].map(|now_s| machine.advance(now_s * SECOND)), [None; 2]);
        assert!(machine.now_ns().unwrap() > 1_000_000_000_000_000_000 && !machine.is_of_before(0));
    }
}
