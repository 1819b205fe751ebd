//! A sector of the circle around the lidar, classified for replica 0.

use super::{Inputs, generation, has_grid_of};
use crate::Sector;
use flockslam_bus::{Notifier, SlicePublisher};
use flockslam_messages::{PoseEstimate, PoseFlags, SectorHeader, Stage};
use flockslam_stage::{Actor, StageContext, StageError, Waited};

/// A replica other than the first.
pub(super) struct Helper {
    inputs: Inputs,
    sector: Option<Sector>,
    header: SectorHeader,
    findings: SlicePublisher<SectorHeader>,
    first: Notifier,
}

impl Helper {
    pub fn open(
        context: &StageContext,
        inputs: Inputs,
        sector: Option<Sector>,
        parts: u32,
    ) -> Result<Self, StageError> {
        let header = SectorHeader { part: context.replica, parts, ..SectorHeader::default() };
        let (findings, first) =
            (context.bus.slice_publisher()?, context.bus.notifier(Stage::DynamicCleaner.name())?);
        Ok(Self { inputs, sector, header, findings, first })
    }

    /// Handles the oldest pose; false when its join is not complete.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        let Inputs { logic, join, grid } = &mut self.inputs;
        let sector = self.sector.filter(|_| pose.has(PoseFlags::INSERT) && logic.classifies(pose));
        let Some(sector) = sector else { return Ok(true) };
        match join.wait(has_grid_of(grid, pose), context.now_ns()) {
            Waited::NotYet => return Ok(false),
            Waited::TooLong => return Ok(true),
            Waited::For(()) => {}
        }
        let (started_ns, generation) = (context.now_ns(), generation(grid));
        let sample = join.scans.take(pose.id.sequence);
        let Some(scan) = sample.as_ref().and_then(|sample| sample.view().ok()) else { return Ok(true) };
        logic.begin(scan, pose);
        logic.look(scan, pose, grid.grid(), sector);
        let found = logic.found();
        let header = SectorHeader { id: pose.id, generation, ..self.header };
        self.findings.send_with(&header, found.len(), |to| to.copy_from_slice(found))?;
        self.first.notify();
        context.handled(pose.id.sequence, started_ns, pose.times.monotonic_ns);
        Ok(true)
    }
}

impl Actor for Helper {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while let Some(pose) = self.inputs.next()? {
            if !self.step(&pose, context)? {
                break;
            }
            self.inputs.join.finished(pose.id.sequence + 1)?;
            any = true;
        }
        Ok(any)
    }

    fn refresh(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        self.findings.refresh();
        Ok(())
    }

    fn waits(&self) -> bool {
        self.inputs.join.waits()
    }
}
