//! Events: a stage sleeps on its event until an input notifies it.

use crate::BusError;
use std::time::Duration;

/// The reason for the end of a wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wake {
    /// No notification came within the limit.
    TimedOut,
    /// There is something to look at.
    Rung,
    /// There will be, in a moment.
    Announced,
}

/// Waits for an event, whatever carries it.
pub(crate) trait Hear {
    fn wait(&self, limit: Duration) -> Result<Wake, BusError>;
}

/// Rings an event, whatever carries it.
pub(crate) trait Ring {
    fn ring(&self);
    fn announce(&self);
}

/// A stage's own event: everything it could wait for rings it. Rings coalesce, so a woken stage drains all its inputs.
pub struct Listener(Box<dyn Hear>);

impl Listener {
    pub(crate) fn new(port: Box<dyn Hear>) -> Self {
        Self(port)
    }

    /// Waits for a notification or until `limit` has passed.
    ///
    /// # Errors
    /// When the event itself is broken.
    pub fn wait(&self, limit: Duration) -> Result<Wake, BusError> {
        self.0.wait(limit)
    }
}

/// Rings the event of one stage (all of its replicas).
pub struct Notifier(Box<dyn Ring>);

impl Notifier {
    pub(crate) fn new(port: Box<dyn Ring>) -> Self {
        Self(port)
    }

    /// Rings. A listener that is gone, or whose event is still ringing, is no error.
    pub fn ring(&self) {
        self.0.ring();
    }

    /// Announces a message that will be there in a moment: a sleeping process needs longer to wake up than to read.
    pub fn announce(&self) {
        self.0.announce();
    }
}
