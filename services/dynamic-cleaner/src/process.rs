//! The shell of dynamic-cleaner: joins accepted scans with the grid that they were matched to, publishes marks.
//!
//! Replica 0 concludes. The others judge the cells in their sectors of the circle and send it what they found.

mod sectors;

use crate::{DynamicCleaner, Sector, Settings};
use flockslam_bus::{BellRinger, ScanSample, SlicePublisher};
use flockslam_messages::{DropReason, MarksHeader, PoseEstimate, PoseFlags, ScanView, Stage, TracksHeader};
use flockslam_stage::{
    Acknowledger, Actor, GridReader, Mode, PendingScans, PoseQueue, StageContext, StageError, run,
};
use flockslam_telemetry::{Counter, monotonic_ns, names};
use sectors::{Helper, Sectors};
use std::time::Duration;

/// Live: a grid that is not there by then is not waited for; the scan clears nothing.
const GRID_DEADLINE_NS: u64 = 50_000_000;
/// A sector that another replica has not sent after this is judged here: the same cells, only later.
const SECTOR_DEADLINE_NS: u64 = 20_000_000;
/// Counts sectors that had to be judged here.
const SECTOR_LATE: &str = "sector-late";

/// Runs the stage until it is asked to stop.
///
/// # Errors
/// When the bus fails.
pub fn run_stage(context: &mut StageContext, settings: Settings, cell_size_m: f64) -> Result<(), StageError> {
    let bell = context.bus.listener(Stage::DynamicCleaner.name())?;
    let parts = settings.replicas.max(1) as u32;
    let inputs = Inputs::open(context, settings, cell_size_m)?;
    if context.replica > 0 {
        // A number beyond the shares has none; it only waits to be told to end.
        let sector = (context.replica < parts).then(|| Sector::new(context.replica, parts));
        return run(context, &mut Helper::open(context, inputs, sector, parts)?, &bell);
    }
    let mut actor = Cleaner {
        inputs,
        sectors: Sectors::open(context, parts)?,
        waiting: None,
        marks: context.bus.slice_publisher()?,
        tracks: context.bus.slice_publisher()?,
        mapper: context.bus.ringer(Stage::Mapper.name())?,
        acknowledger: Acknowledger::open(context, 0)?,
        cleared: 0,
        cleared_cells: context.metrics.counter(names::CLEARED_CELLS),
        moving_beams: context.metrics.counter(names::MOVING_BEAMS),
    };
    run(context, &mut actor, &bell)
}

/// What every replica joins.
struct Inputs {
    logic: DynamicCleaner,
    scans: PendingScans,
    poses: PoseQueue,
    grid: GridReader,
    waiting_since_ns: Option<u64>,
}

impl Inputs {
    fn open(context: &StageContext, settings: Settings, cell_size_m: f64) -> Result<Self, StageError> {
        let grid = GridReader::open(context, cell_size_m)?;
        grid.ask_for_tiles()?;
        Ok(Self {
            logic: DynamicCleaner::new(settings),
            scans: PendingScans::new(context.bus.scan_subscriber()?, context.capacity.window, 0),
            poses: PoseQueue::new(context.bus.subscriber()?, 0),
            grid,
            waiting_since_ns: None,
        })
    }

    fn drain(&mut self) -> Result<(), StageError> {
        self.scans.drain()?;
        self.poses.drain()?;
        self.grid.drain()?;
        Ok(())
    }

    /// Whether the grid that the pose was found in is the present one; `None` when it is still waited for.
    fn grid_is_ready(&mut self, pose: &PoseEstimate, mode: Mode) -> Option<bool> {
        let ready = self.generation() >= pose.generation;
        if !ready {
            let since_ns = *self.waiting_since_ns.get_or_insert_with(monotonic_ns);
            let late = monotonic_ns().saturating_sub(since_ns) > GRID_DEADLINE_NS;
            if mode == Mode::Exact || !late {
                return None;
            }
        }
        self.waiting_since_ns = None;
        Some(ready)
    }

    /// Generation of the present grid.
    fn generation(&self) -> u64 {
        self.grid.committed().map_or(0, |commit| commit.generation)
    }
}

/// The replica that concludes.
struct Cleaner {
    inputs: Inputs,
    sectors: Sectors,
    waiting: Option<Waiting>,
    marks: SlicePublisher<MarksHeader>,
    tracks: SlicePublisher<TracksHeader>,
    mapper: BellRinger,
    acknowledger: Acknowledger,
    cleared: u64,
    cleared_cells: Counter,
    moving_beams: Counter,
}

/// A scan of which others judge their sectors.
struct Waiting {
    pose: PoseEstimate,
    sample: Option<ScanSample>,
    generation: u64,
    started_ns: u64,
}

impl Cleaner {
    fn clean(
        &mut self,
        pose: &PoseEstimate,
        fresh: bool,
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        let started_ns = monotonic_ns();
        let sample = self.inputs.scans.take(pose.id.sequence);
        let generation = self.inputs.generation();
        let scan = sample.as_ref().and_then(|sample| sample.view().ok());
        match scan.filter(|_| fresh) {
            Some(scan) => {
                context.report.report.scan_address = scan.ranges().as_ptr() as u64;
                self.watch(scan, pose)?;
                let logic = &mut self.inputs.logic;
                logic.begin(scan, pose);
                logic.look(scan, pose, self.inputs.grid.grid(), self.sectors.own());
                if self.sectors.parts() > 1 && logic.judges(pose) {
                    self.waiting = Some(Waiting { pose: *pose, sample, generation, started_ns });
                    return Ok(());
                }
                self.conclude(pose)?;
            }
            None => {
                context.dropped(DropReason::Deadline.name());
                let (id, times, generation) = (pose.id, pose.times, pose.generation);
                let nothing = MarksHeader { id, times, generation, ..MarksHeader::default() };
                self.marks.send_with(&nothing, 0, |_| {})?;
            }
        }
        self.end(pose, started_ns, context)
    }

    /// Ends with a shared scan when all sectors are judged; true when none waits.
    fn finish_shared(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let Some(waiting) = &self.waiting else { return Ok(true) };
        let missing = self.sectors.collect(&waiting.pose, waiting.generation, &mut self.inputs.logic)?;
        let late = monotonic_ns().saturating_sub(waiting.started_ns) > SECTOR_DEADLINE_NS;
        if !missing.is_empty() && !late {
            return Ok(false);
        }
        let Some(waiting) = self.waiting.take() else { return Ok(true) };
        let pose = &waiting.pose;
        let scan = waiting.sample.as_ref().and_then(|sample| sample.view().ok());
        for (sector, scan) in missing.into_iter().zip(scan.into_iter().cycle()) {
            context.dropped(SECTOR_LATE);
            self.inputs.logic.look(scan, pose, self.inputs.grid.grid(), sector);
        }
        drop(waiting.sample);
        self.sectors.forget();
        self.conclude(pose)?;
        self.end(pose, waiting.started_ns, context)?;
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
        self.mapper.ring();
        tracing::debug!(scan = pose.id.sequence, cleared_so_far = self.cleared, "cleaned");
        context.handled(pose.id.sequence, started_ns, pose.times.monotonic_ns);
        self.inputs.poses.pop();
        self.acknowledger.finished(pose.id.sequence + 1)
    }

    /// Publishes who moves at a scan.
    fn watch(&mut self, scan: ScanView<'_>, pose: &PoseEstimate) -> Result<(), StageError> {
        let tracks = self.inputs.logic.watch(scan, pose, self.inputs.grid.grid());
        let count = tracks.len() as u32;
        let header = TracksHeader { id: pose.id, times: pose.times, count, reserved: 0 };
        Ok(self.tracks.send_with(&header, tracks.len(), |to| to.copy_from_slice(tracks))?)
    }

    /// Handles the oldest pose; false when its join is not complete.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        if pose.has(PoseFlags::INSERT) {
            let Some(fresh) = self.inputs.grid_is_ready(pose, context.mode) else { return Ok(false) };
            self.clean(pose, fresh, context)?;
            return Ok(true);
        }
        let fresh = self.inputs.generation() >= pose.generation;
        if !fresh && context.mode == Mode::Exact {
            return Ok(false);
        }
        let sample = self.inputs.scans.take(pose.id.sequence);
        if let Some(scan) = sample.as_ref().and_then(|sample| sample.view().ok()) {
            self.watch(scan, pose)?;
            if fresh {
                self.inputs.logic.look_on(scan, pose, self.inputs.grid.grid());
            }
        }
        self.inputs.scans.release_before(pose.id.sequence + 1);
        self.inputs.poses.pop();
        self.acknowledger.finished(pose.id.sequence + 1)?;
        Ok(true)
    }
}

impl Actor for Cleaner {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while self.finish_shared(context)? {
            self.inputs.drain()?;
            let Some(pose) = self.inputs.poses.front().copied() else { break };
            if !self.step(&pose, context)? {
                break;
            }
            any = true;
        }
        Ok(any)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.marks.refresh();
        self.tracks.refresh();
        context.report.count("cleared_cells", self.cleared);
        if let Some(address) = self.inputs.grid.a_tile_address() {
            context.report.report.tile_address = address as u64;
        }
        self.acknowledger.send()
    }

    fn waiting(&self) -> usize {
        self.inputs.scans.len()
    }

    fn patience(&self) -> Duration {
        let waits = self.inputs.waiting_since_ns.is_some() || self.waiting.is_some();
        Duration::from_millis(if waits { 5 } else { 100 })
    }
}
