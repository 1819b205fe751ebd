//! Decides when a process that ended is restarted. Takes whether it had worked; gives a pause, or that the stage is given up.

use std::time::Duration;

/// Starts in a row that end before the stage has worked, after which it is given up for a while.
const FAILED_STARTS_MAX: u32 = 5;
const BACK_OFF_FIRST: Duration = Duration::from_millis(100);
const BACK_OFF_MAX: Duration = Duration::from_secs(5);

/// When a stage that ended is restarted. Only starts that fail are counted: a stage that was killed in the middle of its work
/// comes back at once, however often that happens.
#[derive(Clone, Debug, Default)]
pub struct RestartPolicy {
    failed_starts: u32,
}

/// What follows a death.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterDeath {
    /// Start it again after this.
    Restart(Duration),
    /// It does not get up: do without it, and try again much later.
    GiveUp,
}

impl RestartPolicy {
    /// A process of the stage ended; `worked` when it had met a scan.
    pub fn died(&mut self, worked: bool) -> AfterDeath {
        self.failed_starts = if worked { 0 } else { self.failed_starts.saturating_add(1) };
        match self.failed_starts {
            0 | 1 => AfterDeath::Restart(Duration::ZERO),
            failed if failed >= FAILED_STARTS_MAX => AfterDeath::GiveUp,
            failed => {
                AfterDeath::Restart((BACK_OFF_FIRST * 2_u32.saturating_pow(failed - 2)).min(BACK_OFF_MAX))
            }
        }
    }

    /// Starts in a row that ended before the stage had worked.
    pub fn failed_starts(&self) -> u32 {
        self.failed_starts
    }

    /// The present process works.
    pub fn works(&mut self) {
        self.failed_starts = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_restart_is_at_once_the_next_later_and_later_and_the_fifth_is_none() {
        let mut policy = RestartPolicy::default();
        let waits: Vec<_> = (0..6).map(|_| policy.died(false)).collect();
        let after = |ms| AfterDeath::Restart(Duration::from_millis(ms));
        assert_eq!(
            waits,
            [after(0), after(100), after(200), after(400), AfterDeath::GiveUp, AfterDeath::GiveUp]
        );
    }

    #[test]
    fn one_handled_scan_resets_and_deaths_at_work_are_never_too_many() {
        let mut policy = RestartPolicy::default();
        for _ in 0..4 {
            policy.died(false);
        }
        policy.works();
        assert_eq!(policy.died(false), AfterDeath::Restart(Duration::ZERO));
        for _ in 0..1000 {
            assert_eq!(policy.died(true), AfterDeath::Restart(Duration::ZERO));
        }
    }
}
