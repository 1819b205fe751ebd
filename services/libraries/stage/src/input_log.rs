//! Says what a stage has used for each scan, for recorders: they can let the stage run again as it was.

use crate::{GridReader, StageContext, StageError};
use flockslam_bus::Publisher;
use flockslam_messages::{ScanId, StageInputs, StageStart};

/// Publishes the inputs of each handled scan. Nobody waits for them.
pub struct InputLog {
    publisher: Publisher<StageInputs>,
    inputs: StageInputs,
}

impl InputLog {
    /// Opens the topic, for a process that begins now and with nothing.
    ///
    /// # Errors
    /// When the topic does not exist.
    pub fn open(context: &StageContext) -> Result<Self, StageError> {
        let inputs =
            StageInputs { process: context.now_ns(), stage: context.stage as u32, ..StageInputs::default() };
        Ok(Self { publisher: context.bus.publisher()?, inputs })
    }

    /// The process goes on after the pose of this scan.
    pub fn resumed(&mut self, start: StageStart, after: ScanId) {
        (self.inputs.start, self.inputs.resumed_after) = (start as u32, after.sequence);
    }

    /// Publishes the inputs of a scan: the grid, and what `more` adds.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn handled(
        &mut self,
        id: ScanId,
        grid: &GridReader,
        more: impl FnOnce(&mut StageInputs),
    ) -> Result<(), StageError> {
        let inputs = &mut self.inputs;
        inputs.id = id;
        inputs.handled += 1;
        inputs.grid = grid.committed().map(|commit| commit.name).unwrap_or_default();
        inputs.first_grid = grid.first_committed();
        inputs.tiles = grid.grid().len() as u32;
        more(inputs);
        Ok(self.publisher.send(inputs)?)
    }

    /// Connects to recorders that have started.
    pub fn refresh(&self) {
        self.publisher.refresh();
    }
}
