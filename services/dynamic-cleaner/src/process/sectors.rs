//! The circle around the lidar judged by several processes.

use super::Inputs;
use crate::{DynamicCleaner, Sector};
use flockslam_bus::{BellRinger, SlicePublisher, SliceSample, SliceSubscriber};
use flockslam_messages::{PoseEstimate, PoseFlags, SectorHeader, Stage};
use flockslam_stage::{Actor, StageContext, StageError};
use flockslam_telemetry::monotonic_ns;
use std::time::Duration;

/// Findings of others that are held while their scan has not come up.
const HELD_MAX: usize = 4;

/// Collects what the replicas of the cleaner have found in their sectors.
pub(super) struct Sectors {
    parts: u32,
    others: SliceSubscriber<SectorHeader>,
    held: Vec<SliceSample<SectorHeader>>,
    /// Sectors of the present scan that are judged, by number.
    judged: Vec<bool>,
}

impl Sectors {
    pub fn open(context: &StageContext, parts: u32) -> Result<Self, StageError> {
        let mut sectors = Self {
            parts,
            others: context.bus.slice_subscriber()?,
            held: Vec::with_capacity(HELD_MAX + 1),
            judged: Vec::new(),
        };
        sectors.forget();
        Ok(sectors)
    }

    pub fn parts(&self) -> u32 {
        self.parts
    }

    /// The sector of the replica that concludes.
    pub fn own(&self) -> Sector {
        Sector::new(0, self.parts)
    }

    /// Hands findings about a scan, made in this generation of the grid, to the logic; gives the sectors that are missing.
    pub fn collect(
        &mut self,
        pose: &PoseEstimate,
        generation: u64,
        logic: &mut DynamicCleaner,
    ) -> Result<Vec<Sector>, StageError> {
        while let Some(sample) = self.others.receive()? {
            // Another replica may be ahead; what is behind is of no use any more.
            if sample.header().id.sequence >= pose.id.sequence {
                self.held.push(sample);
                let surplus = self.held.len().saturating_sub(HELD_MAX);
                self.held.drain(..surplus);
            }
        }
        self.held.retain(|sample| {
            let header = sample.header();
            let fits = (header.id, header.parts, header.generation) == (pose.id, self.parts, generation);
            if let Some(judged) = self.judged.get_mut(header.part as usize).filter(|judged| fits && !**judged)
            {
                *judged = true;
                logic.take(sample.elements());
            }
            header.id.sequence > pose.id.sequence
        });
        let missing = (0..self.parts).zip(&self.judged).filter(|(_, judged)| !**judged);
        Ok(missing.map(|(part, _)| Sector::new(part, self.parts)).collect())
    }

    /// Makes ready for the next scan.
    pub fn forget(&mut self) {
        self.judged.clear();
        self.judged.extend((0..self.parts).map(|part| part == 0));
    }
}

/// Another replica than the first.
pub(super) struct Helper {
    inputs: Inputs,
    sector: Option<Sector>,
    header: SectorHeader,
    findings: SlicePublisher<SectorHeader>,
    first: BellRinger,
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
            (context.bus.slice_publisher()?, context.bus.ringer(Stage::DynamicCleaner.name())?);
        Ok(Self { inputs, sector, header, findings, first })
    }

    /// Handles the oldest pose; false when its join is not complete.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        let sector = self.sector.filter(|_| pose.has(PoseFlags::INSERT) && self.inputs.logic.judges(pose));
        let Some(sector) = sector else {
            self.inputs.scans.release_before(pose.id.sequence + 1);
            return Ok(true);
        };
        let Some(fresh) = self.inputs.grid_is_ready(pose, context.mode) else { return Ok(false) };
        let (started_ns, generation) = (monotonic_ns(), self.inputs.generation());
        let sample = self.inputs.scans.take(pose.id.sequence);
        let scan = sample.as_ref().and_then(|sample| sample.view().ok());
        let Some(scan) = scan.filter(|_| fresh) else { return Ok(true) };
        let logic = &mut self.inputs.logic;
        logic.begin(scan, pose);
        logic.look(scan, pose, self.inputs.grid.grid(), sector);
        let found = logic.found();
        let header = SectorHeader { id: pose.id, generation, ..self.header };
        self.findings.send_with(&header, found.len(), |to| to.copy_from_slice(found))?;
        self.first.ring();
        context.handled(pose.id.sequence, started_ns, pose.times.monotonic_ns);
        Ok(true)
    }
}

impl Actor for Helper {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        loop {
            self.inputs.drain()?;
            let Some(pose) = self.inputs.poses.front().copied() else { break };
            if !self.step(&pose, context)? {
                break;
            }
            self.inputs.poses.pop();
            any = true;
        }
        Ok(any)
    }

    fn refresh(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        self.findings.refresh();
        Ok(())
    }

    fn patience(&self) -> Duration {
        Duration::from_millis(if self.inputs.waiting_since_ns.is_some() { 5 } else { 100 })
    }
}
