//! Corrections of sync-manager, from their arrival until they take effect.

use flockslam_bus::Subscriber;
use flockslam_messages::Correction;
use flockslam_stage::{Mode, StageContext, StageError};
use std::collections::VecDeque;

/// In replay the correction after a scan takes effect so many scans later. Fewer are nearer to live operation, where it comes within
/// milliseconds; with one, matcher and sync-manager would take turns.
const TAKES_EFFECT_AFTER: u64 = 4;

/// Corrections in the order in which they came.
pub(super) struct Corrections {
    subscriber: Subscriber<Correction>,
    waiting: VecDeque<Correction>,
    /// The one that took effect last.
    pub last: Option<Correction>,
    /// The newest scan that sync-manager has concluded.
    concluded: Option<u64>,
    /// Replay: scans that have entered the map and whose corrections are not due yet, oldest first.
    accepted: VecDeque<u64>,
    /// Replay: the newest of them whose correction is due.
    due: Option<u64>,
    /// The newest scan in the map when this process went on with it.
    resumed: Option<u64>,
}

impl Corrections {
    /// Listens to the topic.
    pub fn open(context: &StageContext) -> Result<Self, StageError> {
        Ok(Self {
            subscriber: context.bus.subscriber()?,
            waiting: VecDeque::with_capacity(context.capacity.window),
            last: None,
            concluded: None,
            accepted: VecDeque::with_capacity(2 * TAKES_EFFECT_AFTER as usize),
            due: None,
            resumed: None,
        })
    }

    /// Takes in what has arrived.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while let Some(correction) = self.subscriber.receive()? {
            self.concluded = self.concluded.max(Some(correction.scan));
            self.waiting.push_back(*correction);
        }
        Ok(())
    }

    /// A scan has entered the map: sync-manager will say what follows from it.
    pub fn accepted(&mut self, mode: Mode, sequence: u64) {
        if mode == Mode::Exact {
            self.accepted.push_back(sequence);
        }
    }

    /// The map is gone on with after this scan: what followed from it takes effect at once.
    pub fn resumed(&mut self, sequence: u64) {
        (self.due, self.resumed) = (Some(sequence), Some(sequence));
    }

    /// The next one that takes effect before the scan `next`: live any, in replay at a fixed place.
    pub fn next_due(&mut self, mode: Mode, next: Option<u64>) -> Option<Correction> {
        let is_due = |correction: &Correction| {
            mode == Mode::Live || Some(correction.scan) <= self.resumed || takes_effect(correction.scan, next)
        };
        self.waiting.front().filter(|correction| is_due(correction))?;
        self.last = self.waiting.pop_front();
        self.last
    }

    /// Whether all that take effect before the scan `next` have arrived; live none is waited for.
    pub fn are_ready(&mut self, mode: Mode, next: Option<u64>) -> bool {
        while self.accepted.front().is_some_and(|accepted| takes_effect(*accepted, next)) {
            self.due = self.accepted.pop_front();
        }
        mode == Mode::Live || self.concluded >= self.due
    }
}

fn takes_effect(scan: u64, next: Option<u64>) -> bool {
    next.is_some_and(|next| scan + TAKES_EFFECT_AFTER <= next)
}
