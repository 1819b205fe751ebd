//! Tells a silent process that does not get a processor from one that hangs: to replace it would only make the machine busier.

use std::fs;
use std::time::Duration;

/// A silent process is watched for this share of its deadline before it counts as hung though it wants to run.
const WATCHED_SHARE: f64 = 0.25;
/// A process that has run for less than this share of the time was kept waiting by others.
const RAN_SHARE_MIN: f64 = 0.5;
/// After so many deadlines it counts as hung all the same: an endless loop may be kept waiting too.
const DEADLINES_MAX: u32 = 10;

/// How a process stands with the scheduler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunState {
    /// It runs or waits for a processor; not so one that sleeps or was stopped.
    is_runnable: bool,
    /// Time that its main thread has run, nanoseconds.
    ran_ns: u64,
}

impl RunState {
    /// That of the process `pid`; `None` where the system does not say.
    pub fn of(pid: u32) -> Option<Self> {
        let read = |name: &str| fs::read_to_string(format!("/proc/{pid}/{name}")).ok();
        Self::parse(&read("stat")?, &read("schedstat")?)
    }

    /// From the lines of `/proc/PID/stat` and `/proc/PID/schedstat` (proc(5)).
    fn parse(stat: &str, schedstat: &str) -> Option<Self> {
        // The name before the state is in parentheses, and may have some in it.
        let (_, behind_name) = stat.rsplit_once(')')?;
        let state = behind_name.split_whitespace().next()?;
        let ran_ns = schedstat.split_whitespace().next()?.parse().ok()?;
        Some(Self { is_runnable: state == "R", ran_ns })
    }
}

/// Watches a process that has been silent for its deadline.
#[derive(Debug, Default)]
pub struct StarvationWatch {
    /// When that was seen first, nanoseconds on the monotonic clock, and how it stood then.
    first: Option<(u64, RunState)>,
}

impl StarvationWatch {
    /// The process is not silent, or is another one.
    pub fn reset(&mut self) {
        self.first = None;
    }

    /// Whether the process, silent beyond `deadline`, is waiting for a processor at `now_ns`, so that it is too early to call it hung.
    pub fn starves(&mut self, state: Option<RunState>, now_ns: u64, deadline: Duration) -> bool {
        let Some(state) = state.filter(|state| state.is_runnable) else { return false };
        let (first_ns, first) = *self.first.get_or_insert((now_ns, state));
        let watched = Duration::from_nanos(now_ns.saturating_sub(first_ns));
        let ran = Duration::from_nanos(state.ran_ns.saturating_sub(first.ran_ns));
        let is_watched_enough = watched >= deadline.mul_f64(WATCHED_SHARE);
        let has_run = is_watched_enough && ran >= watched.mul_f64(RAN_SHARE_MIN);
        !has_run && watched < deadline * DEADLINES_MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEADLINE: Duration = Duration::from_millis(500);
    const MS: u64 = 1_000_000;

    /// For how long a silent process is spared that runs for this share of the time, milliseconds.
    fn spared_ms(is_runnable: bool, ran_share: f64) -> u64 {
        let mut watch = StarvationWatch::default();
        let state = |ms: u64| Some(RunState { is_runnable, ran_ns: (ran_share * (ms * MS) as f64) as u64 });
        (0..).find(|ms| !watch.starves(state(*ms), ms * MS, DEADLINE)).unwrap()
    }

    #[test]
    fn who_sleeps_or_was_stopped_hangs_at_once_an_endless_loop_soon_and_who_is_kept_waiting_much_later() {
        assert_eq!(spared_ms(false, 0.0), 0);
        assert_eq!(spared_ms(true, 1.0), 125);
        assert_eq!(spared_ms(true, 0.2), 5000);
        assert!(!StarvationWatch::default().starves(None, 0, DEADLINE), "where the system does not say");
    }

    #[test]
    fn a_process_that_was_not_silent_meanwhile_is_watched_anew() {
        let mut watch = StarvationWatch::default();
        let waits = Some(RunState { is_runnable: true, ran_ns: 0 });
        assert!(watch.starves(waits, 0, DEADLINE) && !watch.starves(waits, 5000 * MS, DEADLINE));
        watch.reset();
        assert!(watch.starves(waits, 5000 * MS, DEADLINE));
    }

    #[test]
    fn the_state_of_a_process_is_read() {
        let state = RunState::parse("7 (a) name) R 1 2", "300687932 1306918393 1500");
        assert_eq!(state, Some(RunState { is_runnable: true, ran_ns: 300_687_932 }));
        assert_eq!(RunState::parse("7 (name) T 1", "5 0 1").map(|state| state.is_runnable), Some(false));
        assert_eq!(RunState::parse("", ""), None);
    }
}
