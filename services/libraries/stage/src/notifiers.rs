//! The events of several stages at once.

use crate::{StageContext, StageError};
use flockslam_bus::Notifier;

/// Events that are notified together, in this order.
pub struct Notifiers(Vec<Notifier>);

impl Notifiers {
    /// The events of these names.
    ///
    /// # Errors
    /// When one does not exist.
    pub fn open(context: &StageContext, names: &[&str]) -> Result<Self, StageError> {
        Ok(Self(names.iter().map(|name| context.bus.notifier(name)).collect::<Result<_, _>>()?))
    }

    /// Notifies them.
    pub fn notify(&self) {
        self.0.iter().for_each(Notifier::notify);
    }

    /// Announces a message that will be there in a moment.
    pub fn announce(&self) {
        self.0.iter().for_each(Notifier::announce);
    }
}
