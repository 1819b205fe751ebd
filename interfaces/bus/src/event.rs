//! Events: a stage sleeps on its event until an input notifies it.

use crate::BusError;
use std::time::Duration;

/// The reason for the end of a wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wake {
    /// No notification came within the limit.
    TimedOut,
    /// A message is available.
    Notified,
    /// There will be, in a moment.
    Announced,
}

/// Waits for an event, whatever carries it.
pub(crate) trait WaitPort {
    fn wait(&self, limit: Duration) -> Result<Wake, BusError>;
}

/// Notifies an event, whatever carries it.
pub(crate) trait NotifyPort {
    fn notify(&self);
    fn announce(&self);
}

/// A stage's own event: everything it could wait for notifies it. Notifications coalesce, so a woken stage drains all its inputs.
pub struct Listener(Box<dyn WaitPort>);

impl Listener {
    pub(crate) fn new(port: Box<dyn WaitPort>) -> Self {
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

/// Notifies the event of one stage (all of its replicas).
pub struct Notifier(Box<dyn NotifyPort>);

impl Notifier {
    pub(crate) fn new(port: Box<dyn NotifyPort>) -> Self {
        Self(port)
    }

    /// Notifies. A listener that is gone, or whose event is still pending, is no error.
    pub fn notify(&self) {
        self.0.notify();
    }

    /// Announces a message that will be there in a moment: a sleeping process needs longer to wake up than to read.
    pub fn announce(&self) {
        self.0.announce();
    }
}
