//! Receiving beside publishers whose process was killed while it made them: for a limited time there is just nothing to
//! receive.

use crate::BusError;
use iceoryx2::port::ReceiveError;
use std::cell::Cell;
use std::fmt::Debug;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A publisher that was only half made when its process was killed is cleaned up within moments. When it is still met after this,
/// something else is wrong.
const LIMIT: Duration = Duration::from_secs(3);

static HALF_MADE: AtomicU64 = AtomicU64::new(0);

/// How often this process has met publishers that were only half made.
pub fn half_made_publishers() -> u64 {
    HALF_MADE.load(Ordering::Relaxed)
}

/// Tolerates publishers whose process was killed while it made them: there is nothing to receive until they are cleaned up.
#[derive(Debug, Default)]
pub struct HalfMadeGuard {
    since: Cell<Option<Instant>>,
}

impl HalfMadeGuard {
    /// The received message; none while a publisher is half made.
    pub fn pass<S>(
        &self,
        topic: &'static str,
        received: Result<Option<S>, ReceiveError>,
    ) -> Result<Option<S>, BusError> {
        match received {
            Ok(sample) => {
                self.since.set(None);
                Ok(sample)
            }
            Err(ReceiveError::ConnectionFailure(failure)) => self.met(topic, failure).map(|()| None),
            Err(error) => Err(BusError::transfer(topic, error)),
        }
    }

    /// A half-made publisher was met.
    fn met(&self, topic: &'static str, failure: impl Debug) -> Result<(), BusError> {
        let since = self.since.get().unwrap_or_else(Instant::now);
        if self.since.replace(Some(since)).is_none() {
            HALF_MADE.fetch_add(1, Ordering::Relaxed);
            tracing::warn!(topic, ?failure, "a publisher is half made: nothing is received until it is gone");
        }
        if since.elapsed() > LIMIT { Err(BusError::transfer(topic, failure)) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_made_publisher_is_nothing_there_for_a_while_and_counted_once() {
        let (guard, before) = (HalfMadeGuard::default(), half_made_publishers());
        for _ in 0..3 {
            assert!(guard.met("scan", "half made").is_ok());
        }
        assert_eq!(half_made_publishers() - before, 1);
        assert!(matches!(guard.pass("scan", Ok(Some(()))), Ok(Some(()))));
        guard.since.set(Instant::now().checked_sub(2 * LIMIT));
        assert!(guard.met("scan", "half made").is_err());
        assert!(guard.pass::<()>("scan", Err(ReceiveError::ExceedsMaxBorrows)).is_err());
    }
}
