//! What a stage says at the end, again and again: whoever starts late hears it too.

use crate::{Notifiers, StageContext, StageError};
use flockslam_bus::Publisher;
use flockslam_messages::{Control, ControlKind};

/// The last thing that a stage has to say on the control topic.
pub struct LastWord {
    control: Publisher<Control>,
    listeners: Notifiers,
    message: Control,
    is_said: bool,
}

impl LastWord {
    /// What will be said, of this run, and whose events will ring.
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
        Ok(Self { control: context.bus.publisher()?, listeners, message, is_said: false })
    }

    /// Says it for the first time.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn say(&mut self, value: u64) -> Result<(), StageError> {
        (self.message.value, self.is_said) = (value, true);
        self.repeat()
    }

    /// Says it again, if it was said.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn repeat(&self) -> Result<(), StageError> {
        self.control.refresh();
        if self.is_said {
            self.control.send(&self.message)?;
            self.listeners.ring();
        }
        Ok(())
    }

    /// Whether it was said.
    pub fn is_said(&self) -> bool {
        self.is_said
    }
}
