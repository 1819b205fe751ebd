//! What the shell does for a back end that localizes: it tells what is believed, obeys orders, and stores the results of the end.

use super::{SyncProcess, known_map};
use flockslam_results as results;
use flockslam_stage::{Mode, StageContext, StageError};
use std::path::Path;

impl SyncProcess {
    /// Tells others where the robot is believed to be in the known map, when that has changed.
    pub(super) fn localized(&mut self, context: &StageContext) -> Result<(), StageError> {
        let Some(localizing) = self.logic.localizing() else { return Ok(()) };
        self.trajectories.frozen(&localizing.take_frozen());
        let status = known_map::status(localizing);
        if !self.is_active || self.localisation.as_ref() == Some(&status) {
            return Ok(());
        }
        // In exact replay corrections have fixed places: after each closed submap.
        let live = context.mode == Mode::Live;
        let submap = self.next_submap.saturating_sub(1);
        let correction = live.then(|| localizing.fresh_correction(submap)).flatten();
        if let Err(error) = status.write(&context.status_dir) {
            tracing::warn!(%error, "the status does not say where the robot is believed to be");
        }
        self.localisation = Some(status);
        match correction {
            Some(correction) => {
                self.correction = Some(correction);
                self.correct(&correction)
            }
            None => Ok(()),
        }
    }

    /// Obeys those who want the robot to be looked for anew.
    pub(super) fn obey(&mut self) -> Result<(), StageError> {
        while let Some(order) = self.orders.receive()? {
            if let Some(localizing) = self.logic.localizing() {
                localizing.relocalize(&order);
            }
        }
        Ok(())
    }

    /// Concludes a run that localized.
    pub(super) fn finish_localizing(&mut self, directory: &Path) -> Result<(), StageError> {
        let Some(localizing) = self.logic.localizing() else { return Ok(()) };
        self.trajectories.frozen(&localizing.take_frozen());
        let solution = localizing.finish();
        self.summary.localisation = Some(localizing.summary());
        self.trajectories.finish(&solution)?;
        known_map::store(directory)?;
        self.summary.detached = known_map::apart(&solution);
        self.summary.trajectories = solution.closures.trajectories;
        self.summary.detached_scans = solution.closures.detached_scans;
        results::write_summary(directory, &self.summary)?;
        self.finished.say(self.summary.scans)
    }
}
