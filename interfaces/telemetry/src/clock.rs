//! The clocks of a process: monotonic time for latency and deadlines, wall time for export.

use crate::failpoint;
use rustix::time::{ClockId, Timespec, clock_gettime};

/// CLOCK_MONOTONIC, nanoseconds since boot: latency and deadlines, comparable between processes of one machine.
pub fn monotonic_ns() -> u64 {
    u64::try_from(nanoseconds(clock_gettime(ClockId::Monotonic))).expect("the monotonic clock starts at zero")
}

/// Wall clock, nanoseconds since 1970 UTC: for export only, it may jump.
pub fn utc_ns() -> i64 {
    let utc_ns = nanoseconds(clock_gettime(ClockId::Realtime));
    if failpoint("wall-clock") { jumping(utc_ns, monotonic_ns()) } else { utc_ns }
}

/// When a log line is written, for people and exports.
pub(crate) fn log_time_ns() -> i64 {
    utc_ns()
}

/// A wall clock that is set forward by an hour and back again every second.
fn jumping(utc_ns: i64, monotonic_ns: u64) -> i64 {
    let hour_ns = 3_600_000_000_000;
    if (monotonic_ns / 1_000_000_000).is_multiple_of(2) { utc_ns + hour_ns } else { utc_ns - hour_ns }
}

fn nanoseconds(time: Timespec) -> i64 {
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_monotonic_clock_never_runs_backwards_and_the_wall_clock_is_of_this_century() {
        let readings: Vec<u64> = (0..1000).map(|_| monotonic_ns()).collect();
        assert!(readings.is_sorted());
        assert!(utc_ns() > 1_500_000_000_000_000_000);
        assert_eq!(jumping(5, 0) - jumping(5, 1_000_000_000), 7_200_000_000_000);
    }
}
