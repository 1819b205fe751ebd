//! Corrections of sync-manager, from their arrival until they take effect.

use flockslam_bus::Subscriber;
use flockslam_messages::Correction;
use flockslam_stage::{Mode, StageContext, StageError};
use std::collections::VecDeque;

/// Corrections in the order in which they came.
pub(super) struct Corrections {
    subscriber: Subscriber<Correction>,
    waiting: VecDeque<Correction>,
    /// The one that took effect last.
    pub last: Option<Correction>,
    /// sync-manager has finished with all submaps below this.
    finished_submaps: u32,
}

impl Corrections {
    /// Listens to the topic.
    pub fn open(context: &StageContext) -> Result<Self, StageError> {
        let subscriber = context.bus.subscriber()?;
        Ok(Self { subscriber, waiting: VecDeque::new(), last: None, finished_submaps: 0 })
    }

    /// Takes in what has arrived.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while let Some(correction) = self.subscriber.receive()? {
            self.finished_submaps = self.finished_submaps.max(correction.submap + 1);
            self.waiting.push_back(*correction);
        }
        Ok(())
    }

    /// The next one that takes effect while scans enter submap `active`. In replay this is a fixed place: the first scan of the submap
    /// after the next.
    pub fn next_due(&mut self, mode: Mode, active: u32) -> Option<Correction> {
        let is_due = |correction: &Correction| mode == Mode::Live || correction.submap + 2 <= active;
        self.waiting.front().filter(|correction| is_due(correction))?;
        self.last = self.waiting.pop_front();
        self.last
    }

    /// Whether scans may enter submap `active`: in replay sync-manager is not more than one submap behind.
    pub fn are_ready(&self, mode: Mode, active: u32) -> bool {
        mode == Mode::Live || active < 2 || self.finished_submaps >= active - 1
    }
}
