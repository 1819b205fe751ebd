//! Limits of time and of bytes: work that rests in proportion to what it took, and a budget of bytes per minute.

use std::time::{Duration, Instant};

/// Keeps work that takes long to a share of the time.
pub struct Pace {
    pause: Duration,
    rest: u32,
    next: Option<Instant>,
}

impl Pace {
    /// Work that rests at least this long between two times, and at least `rest` times as long as it took.
    pub fn new(pause: Duration, rest: u32) -> Self {
        Self { pause, rest, next: None }
    }

    /// Whether it is time again.
    pub fn is_due(&self, now: Instant) -> bool {
        self.next.is_none_or(|next| now >= next)
    }

    /// Does the work and takes note of when the next time is.
    pub fn keep<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let started = Instant::now();
        let done = work();
        let ended = Instant::now();
        self.next = Some(ended + self.pause.max(self.rest * (ended - started)));
        done
    }
}

/// Bytes that may be sent: as many as flow in over a minute, and no more than a minute's worth at once.
pub struct Budget {
    per_minute: u64,
    left: f64,
    filled: Instant,
}

impl Budget {
    /// A full one.
    pub fn new(per_minute: u64, now: Instant) -> Self {
        Self { per_minute, left: per_minute as f64, filled: now }
    }

    /// What may be sent now.
    pub fn left(&mut self, now: Instant) -> usize {
        let flowed = now.saturating_duration_since(self.filled).as_secs_f64() * self.per_minute as f64 / 60.0;
        self.left = (self.left + flowed).min(self.per_minute as f64);
        self.filled = now;
        self.left.max(0.0) as usize
    }

    /// Takes note of what was sent; more than was left is paid for later.
    pub fn spend(&mut self, bytes: usize) {
        self.left -= bytes as f64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_fills_up_to_a_minutes_worth() {
        let start = Instant::now();
        let at = |s: f64| start + Duration::from_secs_f64(s);
        let mut budget = Budget::new(6000, start);
        assert_eq!(budget.left(at(100.0)), 6000);
        budget.spend(7000);
        assert_eq!(budget.left(at(105.0)), 0);
        assert_eq!(budget.left(at(120.0)), 1000);
        assert_eq!(budget.left(at(1e6)), 6000);
    }

    #[test]
    fn work_rests_a_multiple_of_what_it_took() {
        let mut pace = Pace::new(Duration::from_millis(1), 3);
        assert!(pace.is_due(Instant::now()));
        let before = Instant::now();
        pace.keep(|| std::thread::sleep(Duration::from_millis(20)));
        assert!(!pace.is_due(before + Duration::from_millis(75)));
        assert!(pace.is_due(before + Duration::from_secs(60)));
    }
}
