//! The shell of dynamic-cleaner: joins accepted scans with the grid that they were matched to, publishes marks.

use crate::{DynamicCleaner, Settings};
use flockslam_bus::{BellRinger, SlicePublisher};
use flockslam_messages::{DropReason, MarksHeader, PoseEstimate, PoseFlags, ScanView, Stage, TracksHeader};
use flockslam_stage::{
    Acknowledger, Actor, GridReader, Mode, PendingScans, PoseQueue, StageContext, StageError, run,
};
use flockslam_telemetry::monotonic_ns;
use std::time::Duration;

/// Live: a grid that is not there by then is not waited for; the scan clears nothing.
const GRID_DEADLINE_NS: u64 = 50_000_000;

/// Runs the stage until it is asked to stop.
///
/// # Errors
/// When the bus fails.
pub fn run_stage(context: &mut StageContext, settings: Settings, cell_size_m: f64) -> Result<(), StageError> {
    let bell = context.bus.listener(Stage::DynamicCleaner.name())?;
    let grid = GridReader::open(context, cell_size_m)?;
    grid.ask_for_tiles()?;
    let mut actor = Cleaner {
        logic: DynamicCleaner::new(settings),
        scans: PendingScans::new(context.bus.scan_subscriber()?, context.capacity.window, 0),
        poses: PoseQueue::new(context.bus.subscriber()?, 0),
        grid,
        marks: context.bus.slice_publisher()?,
        tracks: context.bus.slice_publisher()?,
        mapper: context.bus.ringer(Stage::Mapper.name())?,
        acknowledger: Acknowledger::open(context, 0)?,
        waiting_since_ns: None,
        cleared: 0,
    };
    run(context, &mut actor, &bell)
}

struct Cleaner {
    logic: DynamicCleaner,
    scans: PendingScans,
    poses: PoseQueue,
    grid: GridReader,
    marks: SlicePublisher<MarksHeader>,
    tracks: SlicePublisher<TracksHeader>,
    mapper: BellRinger,
    acknowledger: Acknowledger,
    waiting_since_ns: Option<u64>,
    cleared: u64,
}

impl Cleaner {
    /// Whether the grid that the pose was found in is the present one.
    fn grid_is_ready(&self, pose: &PoseEstimate) -> bool {
        let generation = self.grid.committed().map_or(0, |commit| commit.generation);
        generation >= pose.generation
    }

    fn clean(
        &mut self,
        pose: &PoseEstimate,
        fresh: bool,
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        let started_ns = monotonic_ns();
        let sample = self.scans.take(pose.id.sequence);
        let scan = sample.as_ref().and_then(|sample| sample.view().ok());
        let nothing = MarksHeader {
            id: pose.id,
            times: pose.times,
            generation: pose.generation,
            ..MarksHeader::default()
        };
        match scan.filter(|_| fresh) {
            Some(scan) => {
                context.report.report.scan_address = scan.ranges().as_ptr() as u64;
                self.watch(scan, pose)?;
                let marks = self.logic.handle(scan, pose, self.grid.grid());
                self.cleared += marks.cleared.len() as u64;
                self.marks
                    .send_with(&marks.header, marks.cleared.len(), |to| to.copy_from_slice(marks.cleared))?;
            }
            None => {
                context.dropped(DropReason::Deadline.name());
                self.marks.send_with(&nothing, 0, |_| {})?;
            }
        }
        self.mapper.ring();
        context.handled(pose.id.sequence, started_ns, pose.times.monotonic_ns);
        Ok(())
    }

    /// Publishes who moves at a scan.
    fn watch(&mut self, scan: ScanView<'_>, pose: &PoseEstimate) -> Result<(), StageError> {
        let tracks = self.logic.watch(scan, pose, self.grid.grid());
        let count = tracks.len() as u32;
        let header = TracksHeader { id: pose.id, times: pose.times, count, reserved: 0 };
        Ok(self.tracks.send_with(&header, tracks.len(), |to| to.copy_from_slice(tracks))?)
    }

    /// Handles the oldest pose; false when its join is not complete.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        let inserted = pose.has(PoseFlags::INSERT);
        let ready = self.grid_is_ready(pose);
        if !inserted && !ready && context.mode == Mode::Exact {
            return Ok(false);
        }
        if inserted {
            if !ready {
                let since_ns = *self.waiting_since_ns.get_or_insert_with(monotonic_ns);
                let late = monotonic_ns().saturating_sub(since_ns) > GRID_DEADLINE_NS;
                if context.mode == Mode::Exact || !late {
                    return Ok(false);
                }
            }
            self.waiting_since_ns = None;
            self.clean(pose, ready, context)?;
        } else if let Some(sample) = self.scans.take(pose.id.sequence)
            && let Ok(scan) = sample.view()
        {
            self.watch(scan, pose)?;
            if ready {
                self.logic.look_on(scan, pose, self.grid.grid());
            }
        }
        self.acknowledger.finished(pose.id.sequence + 1)?;
        Ok(true)
    }
}

impl Actor for Cleaner {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        loop {
            self.scans.drain()?;
            self.poses.drain()?;
            self.grid.drain()?;
            let Some(pose) = self.poses.front().copied() else { break };
            if !self.step(&pose, context)? {
                break;
            }
            self.poses.pop();
            any = true;
        }
        Ok(any)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.marks.refresh();
        self.tracks.refresh();
        context.report.count("cleared_cells", self.cleared);
        if let Some(address) = self.grid.a_tile_address() {
            context.report.report.tile_address = address as u64;
        }
        self.acknowledger.send()
    }

    fn patience(&self) -> Duration {
        Duration::from_millis(if self.waiting_since_ns.is_some() { 5 } else { 100 })
    }
}
