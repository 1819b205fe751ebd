//! The time that stands beside messages of zenoh: when their sender sent them.

use std::time::{SystemTime, UNIX_EPOCH};

/// UTC, nanoseconds; 0 before 1970.
pub fn sender_clock_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}
