//! The last message of a stage. It is repeated, so that processes that start late read it too.

use crate::{Notifiers, StageContext, StageError};
use flockslam_bus::Publisher;
use flockslam_messages::{Control, ControlKind};

/// The last message of a stage on the control topic.
pub struct FinalMessage {
    control: Publisher<Control>,
    listeners: Notifiers,
    message: Control,
    is_sent: bool,
}

impl FinalMessage {
    /// Prepares the message of this run and the events that it notifies.
    ///
    /// # Errors
    /// When the topic does not exist.
    pub fn open(
        context: &StageContext,
        kind: ControlKind,
        run: u32,
        listeners: Notifiers,
    ) -> Result<Self, StageError> {
        let message = Control { kind: kind as u32, run, value: 0 };
        Ok(Self { control: context.bus.publisher()?, listeners, message, is_sent: false })
    }

    /// Sends it for the first time.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn send(&mut self, value: u64) -> Result<(), StageError> {
        (self.message.value, self.is_sent) = (value, true);
        self.repeat()
    }

    /// Repeats it, if it was sent.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn repeat(&self) -> Result<(), StageError> {
        self.control.refresh();
        if self.is_sent {
            self.control.send(&self.message)?;
            self.listeners.notify();
        }
        Ok(())
    }

    /// Whether it was sent.
    pub fn is_sent(&self) -> bool {
        self.is_sent
    }
}
