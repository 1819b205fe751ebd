//! A limit on waiting.

use crate::Mode;

/// A limit on waiting, and when the wait began. Times are of the monotonic clock, nanoseconds.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    /// `None` waits for ever.
    limit_ns: Option<u64>,
    since_ns: Option<u64>,
}

impl Deadline {
    /// A limit in any mode.
    pub fn new(limit_ns: u64) -> Self {
        Self { limit_ns: Some(limit_ns), since_ns: None }
    }

    /// A limit that holds in live operation; exact replay has none.
    pub fn live(mode: Mode, limit_ns: u64) -> Self {
        Self { limit_ns: Some(limit_ns).filter(|_| mode == Mode::Live), since_ns: None }
    }

    /// Whether a wait that began at `since_ns` is over at `now_ns`.
    pub fn is_over(&self, since_ns: u64, now_ns: u64) -> bool {
        self.limit_ns.is_some_and(|limit_ns| now_ns.saturating_sub(since_ns) > limit_ns)
    }

    /// Begins the wait, unless it has begun. True once the limit has passed.
    pub fn passes(&mut self, now_ns: u64) -> bool {
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        self.is_over(since_ns, now_ns)
    }

    /// Waits no longer.
    pub fn end(&mut self) {
        self.since_ns = None;
    }

    /// Whether a wait has begun.
    pub fn runs(&self) -> bool {
        self.since_ns.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_counts_from_the_first_look_until_the_wait_ends() {
        let mut live = Deadline::live(Mode::Live, 10);
        assert!(!live.runs() && !live.passes(100) && live.runs());
        assert!(!live.passes(110) && live.passes(111));
        live.end();
        assert!(!live.runs() && !live.passes(111));
        assert!(live.is_over(5, 16) && !live.is_over(20, 16));
    }

    #[test]
    fn exact_replay_waits_for_ever() {
        let mut exact = Deadline::live(Mode::Exact, 10);
        assert!(!exact.passes(0) && !exact.passes(u64::MAX) && exact.runs());
        assert!(Deadline::new(10).is_over(0, 11));
    }
}
