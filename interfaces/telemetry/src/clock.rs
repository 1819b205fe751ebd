use rustix::time::{ClockId, Timespec, clock_gettime};

/// CLOCK_MONOTONIC, nanoseconds since boot: latency and deadlines, comparable between processes of one machine.
pub fn monotonic_ns() -> u64 {
    u64::try_from(nanoseconds(clock_gettime(ClockId::Monotonic))).expect("the monotonic clock starts at zero")
}

/// Wall clock, nanoseconds since 1970 UTC: for export only, it may jump.
pub fn utc_ns() -> i64 {
    nanoseconds(clock_gettime(ClockId::Realtime))
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
    }
}
