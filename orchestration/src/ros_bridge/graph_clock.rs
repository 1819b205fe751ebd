//! The time in the graph: that of the machine, or of a simulation.

use flockslam_telemetry::utc_ns;

/// The time in the graph.
#[derive(Debug, Default)]
pub struct GraphClock {
    is_simulated: bool,
    /// What `/clock` said last, nanoseconds.
    heard_ns: Option<i64>,
}

impl GraphClock {
    /// A clock that follows `/clock`, or the machine.
    pub fn new(is_simulated: bool) -> Self {
        Self { is_simulated, heard_ns: None }
    }

    /// Takes what `/clock` says; true when time has gone back.
    pub fn hear(&mut self, now_ns: i64) -> bool {
        let before_ns = self.heard_ns.replace(now_ns);
        self.is_simulated && before_ns.is_some_and(|before_ns| now_ns < before_ns)
    }

    /// The time to stamp what has no other, nanoseconds: that of the machine while a simulation has said none.
    pub fn stamp_ns(&self) -> i64 {
        self.now_ns().unwrap_or_else(utc_ns)
    }

    /// The time, nanoseconds; `None` before a simulation has said it.
    pub fn now_ns(&self) -> Option<i64> {
        if self.is_simulated { self.heard_ns } else { Some(utc_ns()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_simulation_says_the_time_and_may_begin_again() {
        let mut clock = GraphClock::new(true);
        assert_eq!(clock.now_ns(), None);
        assert_eq!([5, 7, 3].map(|now_ns| clock.hear(now_ns)), [false, false, true]);
        assert_eq!(clock.now_ns(), Some(3));
        let mut machine = GraphClock::new(false);
        assert_eq!([5, 3].map(|now_ns| machine.hear(now_ns)), [false, false]);
        assert!(machine.now_ns().unwrap() > 1_000_000_000_000_000_000);
    }
}
