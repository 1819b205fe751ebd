//! Submaps on their way to the store. Live, those that a full disk refuses wait in memory until there is room.

use super::output::Output;
use flockslam_evidence::Submap;
use flockslam_results::SubmapStore;
use flockslam_stage::{Mode, Refusal, StageContext, StageError};
use std::collections::VecDeque;

/// The store, and what is not in it yet.
pub(super) struct Unsaved {
    store: SubmapStore,
    /// Oldest first, and whether the submap is a new one, which is announced once it is stored.
    submaps: VecDeque<(Submap, bool)>,
    refusal: Refusal,
    may_wait: bool,
}

impl Unsaved {
    pub fn new(context: &StageContext) -> Self {
        Self {
            store: SubmapStore::new(&context.submap_dir),
            submaps: VecDeque::new(),
            refusal: Refusal::default(),
            // Exact replay waits for the submap, and so ends with the reason.
            may_wait: context.mode == Mode::Live,
        }
    }

    /// The store.
    pub fn store(&self) -> &SubmapStore {
        &self.store
    }

    /// Whether submaps wait for room.
    pub fn is_refused(&self) -> bool {
        self.refusal.is_set()
    }

    /// Adds a submap that is to be stored.
    pub fn add(&mut self, submap: Submap, is_new: bool) {
        if is_new {
            self.submaps.push_back((submap, true));
            return;
        }
        // Only its last state counts.
        match self.submaps.iter_mut().find(|(waiting, _)| waiting.number == submap.number) {
            Some((waiting, _)) => *waiting = submap,
            None => self.submaps.push_back((submap, false)),
        }
    }

    /// Stores what waits, and announces the new ones.
    ///
    /// # Errors
    /// In exact replay when the disk refuses.
    pub fn save(&mut self, output: &Output) -> Result<(), StageError> {
        while let Some((submap, is_new)) = self.submaps.front() {
            // What is stored already is not coded anew, unless it is gone, or the submap has retired since.
            let is_marked = !is_new && self.store.save_cleared(submap).is_ok();
            let saved = if is_marked { Ok(()) } else { self.store.save(submap) };
            if let Err(error) = saved {
                if !self.may_wait {
                    return Err(error.into());
                }
                if !self.refusal.is_set() {
                    tracing::error!(%error, number = submap.number, "a submap waits in memory");
                }
                self.refusal.set(true);
                return Ok(());
            }
            if *is_new {
                output.publish_submap(&self.store.notice(submap)?)?;
            }
            self.submaps.pop_front();
        }
        self.refusal.set(false);
        Ok(())
    }
}
