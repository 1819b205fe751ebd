//! The clock of latency and deadlines.

use flockslam_telemetry::monotonic_ns;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What a shell takes for the monotonic clock.
#[derive(Clone, Debug, Default)]
pub enum Clock {
    /// That of the system: comparable between the processes of a set.
    #[default]
    System,
    /// One that only moves when it is set: one thread then drives several stages, and a test decides when a deadline passes.
    Virtual(Arc<AtomicU64>),
}

impl Clock {
    /// A virtual clock that begins at `now_ns`, nanoseconds.
    pub fn virtual_at(now_ns: u64) -> Self {
        Self::Virtual(Arc::new(AtomicU64::new(now_ns)))
    }

    /// Now, nanoseconds.
    pub fn now_ns(&self) -> u64 {
        match self {
            Self::System => monotonic_ns(),
            Self::Virtual(now_ns) => now_ns.load(Ordering::Relaxed),
        }
    }

    /// Lets time pass, nanoseconds. The clock of the system goes by itself.
    pub fn advance(&self, by_ns: u64) {
        if let Self::Virtual(now_ns) = self {
            now_ns.fetch_add(by_ns, Ordering::Relaxed);
        }
    }
}
