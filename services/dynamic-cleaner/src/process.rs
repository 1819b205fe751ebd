//! The shell of dynamic-cleaner: joins accepted scans with the grid that they were matched to, publishes marks.
//!
//! Replica 0 publishes the marks. The others classify the cells in their sectors of the circle and send it their findings.

mod sectors;

use crate::{DynamicCleaner, Sector, Settings};
use flockslam_bus::{Notifier, ScanSample, SlicePublisher, SliceSample, SliceSubscriber};
use flockslam_messages::{
    DropReason, MarksHeader, PoseEstimate, PoseFlags, ScanView, SectorHeader, Stage, TracksHeader,
};
use flockslam_stage::{
    Actor, GridReader, InputLog, Join, Mode, Shares, StageContext, StageError, Waited, run,
};
use flockslam_telemetry::{Counter, names};
use sectors::Helper;

/// Live: deadline of the grid. Without it the scan clears nothing.
const GRID_DEADLINE_NS: u64 = 50_000_000;
/// Replica 0 waits so long for a sector of another replica; then it classifies the sector itself, with the same result.
const SECTOR_DEADLINE_NS: u64 = 20_000_000;
/// Findings about later scans that are held.
const SECTORS_HELD_MAX: usize = 4;
/// Counts sectors that replica 0 had to classify itself.
const SECTOR_LATE: &str = "sector-late";

/// Runs the stage until its stop is requested.
///
/// # Errors
/// When the bus fails.
pub fn run_stage(context: &mut StageContext, settings: Settings, cell_size_m: f64) -> Result<(), StageError> {
    let event = context.bus.listener(Stage::DynamicCleaner.name())?;
    let mut shell = shell(context, settings, cell_size_m)?;
    run(context, &mut *shell, &event)
}

/// The stage as steps, for a caller with a loop of its own.
///
/// # Errors
/// When the bus fails.
pub fn shell(
    context: &mut StageContext,
    settings: Settings,
    cell_size_m: f64,
) -> Result<Box<dyn Actor>, StageError> {
    let parts = settings.replicas.max(1) as u32;
    let mut inputs = Inputs::open(context, settings, cell_size_m)?;
    if context.replica > 0 {
        inputs.join.set_acknowledges(false);
        // A process with a number beyond the shares has no sector; it only waits for the end.
        let sector = (context.replica < parts).then(|| Sector::new(context.replica, parts));
        return Ok(Box::new(Helper::open(context, inputs, sector, parts)?));
    }
    Ok(Box::new(Cleaner {
        inputs,
        sectors: Shares::new(context.bus.slice_subscriber()?, parts, SECTORS_HELD_MAX, SECTOR_DEADLINE_NS),
        marks: context.bus.slice_publisher()?,
        log: InputLog::open(context)?,
        tracks: context.bus.slice_publisher()?,
        mapper: context.bus.notifier(Stage::Mapper.name())?,
        cleared: 0,
        cleared_cells: context.metrics.counter(names::CLEARED_CELLS),
        moving_beams: context.metrics.counter(names::MOVING_BEAMS),
    }))
}

/// The inputs of every replica.
struct Inputs {
    logic: DynamicCleaner,
    join: Join<PoseEstimate>,
    grid: GridReader,
}

impl Inputs {
    fn open(context: &StageContext, settings: Settings, cell_size_m: f64) -> Result<Self, StageError> {
        let grid = GridReader::open(context, cell_size_m)?;
        grid.request_tiles()?;
        let join = Join::open(context, GRID_DEADLINE_NS)?;
        Ok(Self { logic: DynamicCleaner::new(settings), join, grid })
    }

    /// Reads what has arrived; gives the oldest pose.
    fn next(&mut self) -> Result<Option<PoseEstimate>, StageError> {
        let pose = self.join.oldest()?;
        self.grid.drain()?;
        Ok(pose)
    }
}

/// Generation of the present grid.
fn generation(grid: &GridReader) -> u64 {
    grid.committed().map_or(0, |commit| commit.generation)
}

/// Whether the grid that the pose was found in is there.
fn has_grid_of(grid: &GridReader, pose: &PoseEstimate) -> Option<()> {
    (generation(grid) >= pose.generation).then_some(())
}

/// The replica that publishes.
struct Cleaner {
    inputs: Inputs,
    sectors: Shares<SliceSubscriber<SectorHeader>, Shared>,
    marks: SlicePublisher<MarksHeader>,
    log: InputLog,
    tracks: SlicePublisher<TracksHeader>,
    mapper: Notifier,
    cleared: u64,
    cleared_cells: Counter,
    moving_beams: Counter,
}

/// A scan whose sectors other replicas classify.
struct Shared {
    pose: PoseEstimate,
    sample: Option<ScanSample>,
    generation: u64,
    started_ns: u64,
}

impl Cleaner {
    /// Cleans with an accepted scan, in the grid that its pose was found in; without it nothing is cleared.
    fn clean(
        &mut self,
        pose: &PoseEstimate,
        fresh: bool,
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        let started_ns = context.now_ns();
        let sample = self.inputs.join.scans.take(pose.id.sequence).filter(|_| fresh);
        self.log_inputs(pose, sample.is_some(), fresh)?;
        let generation = generation(&self.inputs.grid);
        let Some(scan) = sample.as_ref().and_then(|sample| sample.view().ok()) else {
            context.dropped(DropReason::Deadline.name());
            let (id, times) = (pose.id, pose.times);
            let nothing = MarksHeader { id, times, generation, ..MarksHeader::default() };
            self.marks.send_with(&nothing, 0, |_| {})?;
            return self.end(pose, started_ns, context);
        };
        context.probe_scan(scan);
        self.watch(scan, pose)?;
        let Inputs { logic, grid, .. } = &mut self.inputs;
        logic.begin(scan, pose);
        logic.look(scan, pose, grid.grid(), Sector::new(0, self.sectors.parts()));
        if self.sectors.parts() > 1 && logic.classifies(pose) {
            let shared = Shared { pose: *pose, sample, generation, started_ns };
            self.sectors.begin(pose.id, shared, started_ns);
            return Ok(());
        }
        self.conclude(pose)?;
        self.end(pose, started_ns, context)
    }

    /// Ends with a shared scan when all sectors are classified; true when none waits.
    fn finish_shared(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let Inputs { logic, grid, .. } = &mut self.inputs;
        let take = |shared: &mut Shared, found: &SliceSample<SectorHeader>| {
            let fits = found.header().generation == shared.generation;
            if fits {
                logic.take(found.elements());
            }
            fits
        };
        let Some((shared, missing)) = self.sectors.finish(context.now_ns(), take)? else {
            return Ok(!self.sectors.waits());
        };
        let (pose, sample) = (&shared.pose, shared.sample.as_ref());
        let scan = sample.and_then(|sample| sample.view().ok());
        for (sector, scan) in missing.into_iter().zip(scan.into_iter().cycle()) {
            context.dropped(SECTOR_LATE);
            logic.look(scan, pose, grid.grid(), Sector::new(sector, self.sectors.parts()));
        }
        self.conclude(pose)?;
        self.end(pose, shared.started_ns, context)?;
        Ok(true)
    }

    fn conclude(&mut self, pose: &PoseEstimate) -> Result<(), StageError> {
        let marks = self.inputs.logic.conclude(pose);
        self.cleared += marks.cleared.len() as u64;
        self.cleared_cells.inc_by(marks.cleared.len() as u64);
        self.moving_beams.inc_by(u64::from(marks.header.moving_beams));
        let copy = |to: &mut [_]| to.copy_from_slice(marks.cleared);
        Ok(self.marks.send_with(&marks.header, marks.cleared.len(), copy)?)
    }

    fn end(
        &mut self,
        pose: &PoseEstimate,
        started_ns: u64,
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        self.mapper.notify();
        tracing::debug!(scan = pose.id.sequence, cleared_so_far = self.cleared, "cleaned");
        context.handled(pose.id.sequence, started_ns, pose.times.monotonic_ns);
        self.inputs.join.finished(pose.id.sequence + 1)
    }

    fn log_inputs(&mut self, pose: &PoseEstimate, scan: bool, grid: bool) -> Result<(), StageError> {
        self.log.handled(pose.id, &self.inputs.grid, |inputs| {
            (inputs.has_scan, inputs.has_grid) = (scan.into(), grid.into());
        })
    }

    /// Publishes the tracks at a scan.
    fn watch(&mut self, scan: ScanView<'_>, pose: &PoseEstimate) -> Result<(), StageError> {
        let tracks = self.inputs.logic.watch(scan, pose, self.inputs.grid.grid());
        let count = tracks.len() as u32;
        let header = TracksHeader { id: pose.id, times: pose.times, count, reserved: 0 };
        Ok(self.tracks.send_with(&header, tracks.len(), |to| to.copy_from_slice(tracks))?)
    }

    /// Handles the oldest pose; false when its join is not complete.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        let ready = has_grid_of(&self.inputs.grid, pose);
        if pose.has(PoseFlags::INSERT) {
            match self.inputs.join.wait(ready, context.now_ns()) {
                Waited::NotYet => return Ok(false),
                waited => self.clean(pose, waited == Waited::For(()), context)?,
            }
            return Ok(true);
        }
        if ready.is_none() && context.mode == Mode::Exact {
            return Ok(false);
        }
        context.passed_over();
        let sample = self.inputs.join.scans.take(pose.id.sequence);
        self.log_inputs(pose, sample.is_some(), ready.is_some())?;
        if let Some(scan) = sample.as_ref().and_then(|sample| sample.view().ok()) {
            self.watch(scan, pose)?;
            if ready.is_some() {
                self.inputs.logic.look_on(scan, pose, self.inputs.grid.grid());
            }
        }
        self.inputs.join.finished(pose.id.sequence + 1)?;
        Ok(true)
    }
}

impl Actor for Cleaner {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while self.finish_shared(context)? {
            let Some(pose) = self.inputs.next()? else { break };
            if !self.step(&pose, context)? {
                break;
            }
            any = true;
        }
        Ok(any)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.marks.refresh();
        self.log.refresh();
        self.tracks.refresh();
        context.report.count("cleared_cells", self.cleared);
        context.probe_tile(&self.inputs.grid);
        self.inputs.join.refresh()
    }

    fn waiting(&self) -> usize {
        self.inputs.join.scans.len()
    }

    fn waits(&self) -> bool {
        self.inputs.join.waits() || self.sectors.waits()
    }
}
