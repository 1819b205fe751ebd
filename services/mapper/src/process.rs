//! The shell of mapper: joins accepted scans with marks, publishes changed tiles and then one commit, stores closed
//! submaps, and rebuilds itself from journal and store when it starts.
//!
//! Of several processes each inserts every scan and publishes its share of the tiles; the first commits for all.

mod metrics;
mod parts;

use crate::{Mapper, Settings};
use flockslam_bus::{BellRinger, Publisher, SliceSubscriber, TilePublisher};
use flockslam_evidence::{Submap, TileKey};
use flockslam_messages::{
    ClearedCell, Commit, Control, ControlKind, DropReason, MarksHeader, PoseEstimate, PoseFlags, ScanView,
    Stage, SubmapClosed,
};
use flockslam_results::SubmapStore;
use flockslam_stage::{
    Acknowledger, Actor, JournalReader, Mode, PendingScans, PoseQueue, StageContext, StageError, StreamEnd,
    run,
};
use flockslam_telemetry::{is_sabotaged, monotonic_ns};
use metrics::MapMetrics;
use parts::Parts;
use std::collections::VecDeque;
use std::time::Duration;

/// Live: marks that are not there by then are not waited for; the scan is inserted without.
const MARKS_DEADLINE_NS: u64 = 50_000_000;

/// Live: tiles of another mapper that are not out by then are not waited for; they become valid with a later commit.
const PARTS_DEADLINE_NS: u64 = 50_000_000;
/// Counts commits without the tiles of another mapper.
const PART_LATE: &str = "part-late";

/// Runs the stage until it is asked to stop.
///
/// # Errors
/// When the bus, the journal or the store fails.
pub fn run_stage(context: &mut StageContext, settings: Settings) -> Result<(), StageError> {
    let bell = context.bus.listener(Stage::Mapper.name())?;
    let parts = settings.replicas.max(1) as u32;
    if context.replica >= parts {
        return run(context, &mut Shareless, &bell);
    }
    let mut actor = MapperProcess::open(context, settings, Parts::open(context, parts)?)?;
    run(context, &mut actor, &bell)
}

/// A process with a number beyond the shares: it only waits to be told to end.
struct Shareless;

impl Actor for Shareless {
    fn advance(&mut self, _context: &mut StageContext) -> Result<bool, StageError> {
        Ok(false)
    }

    fn refresh(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        Ok(())
    }
}

struct MapperProcess {
    logic: Mapper,
    parts: Parts,
    /// An insertion of which the others have not sent their tiles yet, and since when.
    uncommitted: Option<(Commit, u64)>,
    /// Submaps that it closed.
    unstored: Vec<Submap>,
    /// All tiles are sent once more: so many others have not done it yet, since then.
    republishing: Option<(u32, u64)>,
    cell_size_m: f64,
    store: SubmapStore,
    scans: PendingScans,
    poses: PoseQueue,
    marks: SliceSubscriber<MarksHeader>,
    waiting_marks: VecDeque<(u64, Vec<ClearedCell>)>,
    output: Output,
    acknowledger: Acknowledger,
    stream: StreamEnd,
    /// Accepted scans with a sequence below this are in the map.
    applied: u64,
    /// The scan whose pose comes next when none is missed.
    expected: u64,
    journal: JournalReader,
    last: Option<PoseEstimate>,
    waiting_since_ns: Option<u64>,
    /// The last submap is closed.
    map_closed: bool,
    metrics: MapMetrics,
}

/// Everything that the mapper tells others.
struct Output {
    tiles: TilePublisher,
    commits: Publisher<Commit>,
    submaps: Publisher<SubmapClosed>,
    control: Publisher<Control>,
    matcher: BellRinger,
    sync_manager: BellRinger,
    /// Tiles that could not be sent for want of memory: they go out with the next commit.
    unsent: Vec<TileKey>,
}

impl MapperProcess {
    fn open(context: &mut StageContext, settings: Settings, parts: Parts) -> Result<Self, StageError> {
        let bus = &context.bus;
        let output = Output {
            tiles: TilePublisher::open(bus)?,
            commits: bus.publisher()?,
            submaps: bus.publisher()?,
            control: bus.publisher()?,
            matcher: bus.ringer(Stage::ScanMatcher.name())?,
            sync_manager: bus.ringer(Stage::SyncManager.name())?,
            unsent: Vec::new(),
        };
        let mut process = Self {
            cell_size_m: settings.cell_size_m,
            logic: Mapper::of_share(settings, parts.share()),
            parts,
            uncommitted: None,
            unstored: Vec::new(),
            republishing: None,
            store: SubmapStore::new(&context.submap_dir),
            scans: PendingScans::new(bus.scan_subscriber()?, context.capacity.window, 0),
            poses: PoseQueue::new(bus.subscriber()?, 0),
            marks: bus.slice_subscriber()?,
            waiting_marks: VecDeque::new(),
            output,
            acknowledger: Acknowledger::open(context, 0)?,
            stream: StreamEnd::open(context)?,
            applied: 0,
            expected: 0,
            journal: JournalReader::open(&context.journal_dir)?,
            last: None,
            waiting_since_ns: None,
            map_closed: false,
            metrics: MapMetrics::new(&context.metrics),
        };
        process.recover(context)?;
        Ok(process)
    }

    /// Rebuilds the map that a predecessor had: its closed submaps from the store, the active one from the journal.
    fn recover(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        let count = self.store.count();
        let mut inserted = 0;
        for number in 0..count {
            let submap = self.store.load(number)?;
            inserted += u64::from(submap.insertions);
            self.applied = submap.last + 1;
            if self.parts.is_first() {
                self.output.tell_submap(&self.store.notice(&submap)?)?;
            }
            self.logic.resume(submap, inserted);
            context.alive();
        }
        if is_sabotaged("replay-twice") {
            self.applied = 0;
        }
        self.catch_up(u64::MAX, context)?;
        if self.last.is_some() || count > 0 {
            self.republish(context)?;
        }
        self.done(self.expected)
    }

    /// Applies accepted scans of the journal before this sequence that are not in the map yet.
    fn catch_up(&mut self, before: u64, context: &mut StageContext) -> Result<(), StageError> {
        while let Some(record) = self.journal.read_before(before)?.filter(|_| !is_sabotaged("no-replay")) {
            context.alive();
            self.expected = self.expected.max(record.pose.id.sequence + 1);
            let Some(scan) = record.scan.filter(|_| record.pose.id.sequence >= self.applied) else {
                continue;
            };
            let Ok(scan) = scan.view() else { continue };
            self.apply(scan, &record.pose, &[])?;
            // What the others have of it becomes valid with a later commit.
            self.commit()?;
            self.store()?;
        }
        Ok(())
    }

    fn apply(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        cleared: &[ClearedCell],
    ) -> Result<(), StageError> {
        assert!(pose.id.sequence >= self.applied, "a scan enters the map once");
        let insertion = self.logic.insert(scan, pose, cleared);
        let commit = Commit {
            id: pose.id,
            times: pose.times,
            generation: insertion.generation,
            tiles: insertion.changed.len() as u32,
            active_submap: insertion.active_submap,
        };
        let (closed, tiles) = (insertion.closed, insertion.changed.len());
        self.output.unsent.extend_from_slice(insertion.changed);
        self.output.retire(insertion.retired, commit.generation, self.cell_size_m)?;
        self.output.send_tiles(&self.logic, commit.generation, self.cell_size_m)?;
        self.applied = pose.id.sequence + 1;
        self.last = Some(*pose);
        if !self.parts.is_first() {
            self.logic.take_cleared();
            return self.parts.tell(pose, tiles, false);
        }
        self.unstored.extend(closed);
        self.uncommitted = Some((commit, monotonic_ns()));
        Ok(())
    }

    /// Makes the last insertion valid when all have sent their tiles, or, live, are not waited for any longer; false while they are.
    fn commit_when_whole(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let Some((commit, since_ns)) = &mut self.uncommitted else { return Ok(true) };
        if self.parts.others() > 0 {
            self.parts.drain()?;
            match self.parts.have_inserted(commit.id.sequence) {
                Some(tiles) => commit.tiles += tiles,
                None => {
                    let late = monotonic_ns().saturating_sub(*since_ns) > PARTS_DEADLINE_NS;
                    if context.mode == Mode::Exact || !late {
                        return Ok(false);
                    }
                    context.dropped(PART_LATE);
                }
            }
        }
        self.commit()?;
        self.store()?;
        Ok(true)
    }

    fn commit(&mut self) -> Result<(), StageError> {
        let Some((commit, _)) = self.uncommitted.take() else { return Ok(()) };
        self.output.commits.send(&commit)?;
        self.output.matcher.ring();
        Ok(())
    }

    /// Stores submaps that were closed, and those anew in which cells were cleared since. Nobody waits for it: the scan is committed.
    fn store(&mut self) -> Result<(), StageError> {
        for submap in self.unstored.drain(..) {
            self.store.save(&submap)?;
            self.output.tell_submap(&self.store.notice(&submap)?)?;
        }
        Ok(self.logic.take_cleared().iter().try_for_each(|submap| self.store.save(submap))?)
    }

    /// Sends all live tiles and the last commit again: a reader has started and holds none.
    fn republish(&mut self, context: &StageContext) -> Result<(), StageError> {
        let Some(last) = self.last else { return Ok(()) };
        self.send_all_tiles()?;
        if !self.parts.is_first() {
            return self.parts.tell(&last, self.logic.live_tiles().count(), true);
        }
        if self.parts.others() > 0 {
            self.republishing = Some((self.parts.others(), monotonic_ns()));
            return Ok(());
        }
        self.commit_again(context)
    }

    /// Makes all tiles valid once every mapper has sent its own again, or is not waited for any longer.
    fn commit_again_when_whole(&mut self, context: &StageContext) -> Result<(), StageError> {
        if self.parts.others() == 0 {
            return Ok(());
        }
        self.parts.drain()?;
        let republished = self.parts.take_republished();
        let late = match &mut self.republishing {
            Some((missing, since_ns)) => {
                *missing = missing.saturating_sub(republished);
                *missing == 0 || monotonic_ns().saturating_sub(*since_ns) > PARTS_DEADLINE_NS
            }
            // A mapper that has recovered.
            None => republished > 0,
        };
        if late && self.uncommitted.is_none() {
            self.republishing = None;
            self.commit_again(context)?;
        }
        Ok(())
    }

    fn send_all_tiles(&mut self) -> Result<(), StageError> {
        self.output.unsent = self.logic.live_tiles().collect();
        let generation = self.logic.generation();
        self.output.send_tiles(&self.logic, generation, self.cell_size_m)
    }

    fn commit_again(&mut self, context: &StageContext) -> Result<(), StageError> {
        let Some(last) = self.last else { return Ok(()) };
        let commit = Commit {
            id: last.id,
            times: last.times,
            generation: self.logic.generation(),
            tiles: self.logic.live_tiles().count() as u32,
            active_submap: self.logic.active_submap(),
        };
        self.output.commits.send(&commit)?;
        self.output.matcher.ring();
        context.bus.ringer(Stage::DynamicCleaner.name())?.ring();
        Ok(())
    }

    fn drain_marks(&mut self) -> Result<(), StageError> {
        while let Some(marks) = self.marks.receive()? {
            self.waiting_marks.push_back((marks.header().id.sequence, marks.elements().to_vec()));
        }
        Ok(())
    }

    /// The marks of a scan, once they are there; live they are not waited for past their deadline.
    fn take_marks(&mut self, sequence: u64, context: &mut StageContext) -> Option<Vec<ClearedCell>> {
        while self.waiting_marks.front().is_some_and(|(of, _)| *of < sequence) {
            self.waiting_marks.pop_front();
        }
        if self.waiting_marks.front().is_some_and(|(of, _)| *of == sequence) {
            self.waiting_since_ns = None;
            return self.waiting_marks.pop_front().map(|(_, cleared)| cleared);
        }
        let since_ns = *self.waiting_since_ns.get_or_insert_with(monotonic_ns);
        let late = context.mode == Mode::Live && monotonic_ns().saturating_sub(since_ns) > MARKS_DEADLINE_NS;
        if late {
            self.waiting_since_ns = None;
            context.dropped(DropReason::Deadline.name());
        }
        late.then(Vec::new)
    }

    /// Handles the oldest pose; false when its join is not complete.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        let sequence = pose.id.sequence;
        if context.mode == Mode::Live && sequence > self.expected {
            // Poses were missed while this process was held up; what they accepted is in the journal.
            self.catch_up(sequence, context)?;
        }
        self.expected = self.expected.max(sequence + 1);
        if !pose.has(PoseFlags::INSERT) || sequence < self.applied {
            self.poses.pop();
            self.scans.release_before(sequence + 1);
            self.done(sequence + 1)?;
            return Ok(true);
        }
        let Some(cleared) = self.take_marks(sequence, context) else { return Ok(false) };
        let started_ns = monotonic_ns();
        let sample = self.scans.take(sequence);
        match sample.as_ref().and_then(|sample| sample.view().ok()) {
            Some(scan) => {
                context.report.report.scan_address = scan.ranges().as_ptr() as u64;
                self.apply(scan, pose, &cleared)?;
            }
            // It was sent before this process listened; the journal has every accepted scan.
            None => self.catch_up(sequence + 1, context)?,
        }
        self.poses.pop();
        self.metrics.inserted(sequence, cleared.len());
        context.handled(sequence, started_ns, pose.times.monotonic_ns);
        self.done(sequence + 1)?;
        Ok(true)
    }

    /// Scans below this sequence are taken in. The first mapper speaks for all.
    fn done(&mut self, sequence: u64) -> Result<(), StageError> {
        if self.parts.is_first() {
            return self.acknowledger.finished(sequence);
        }
        self.acknowledger.note(sequence);
        Ok(())
    }

    fn close_map(&mut self) -> Result<(), StageError> {
        self.map_closed = true;
        if !self.parts.is_first() {
            return Ok(());
        }
        self.unstored.extend(self.logic.close());
        self.store()?;
        self.repeat_the_end()
    }

    fn repeat_the_end(&self) -> Result<(), StageError> {
        if !self.parts.is_first() {
            return Ok(());
        }
        let value = u64::from(self.store.count());
        self.output.control.send(&Control { kind: ControlKind::MapClosed as u32, epoch: 0, value })?;
        self.output.sync_manager.ring();
        Ok(())
    }
}

impl Output {
    fn send_tiles(&mut self, logic: &Mapper, generation: u64, cell_size_m: f64) -> Result<(), StageError> {
        let mut sent = 0;
        for key in &self.unsent {
            let outcome = self.tiles.send_with(*key, |message| {
                (message.generation, message.cell_size_m) = (generation, cell_size_m);
                logic.write_tile(*key, &mut message.tile);
            });
            if let Err(error) = outcome {
                tracing::warn!(%error, "tiles wait for memory");
                break;
            }
            sent += 1;
        }
        self.unsent.drain(..sent);
        Ok(())
    }

    fn retire(&mut self, keys: &[TileKey], generation: u64, cell_size_m: f64) -> Result<(), StageError> {
        for key in keys {
            self.tiles.send_with(*key, |message| {
                (message.generation, message.cell_size_m) = (generation, cell_size_m);
                message.retired = 1;
            })?;
        }
        Ok(())
    }

    fn tell_submap(&self, notice: &SubmapClosed) -> Result<(), StageError> {
        self.submaps.send(notice)?;
        self.sync_manager.ring();
        Ok(())
    }
}

impl Actor for MapperProcess {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while self.commit_when_whole(context)? {
            self.scans.drain()?;
            self.poses.drain()?;
            self.drain_marks()?;
            let Some(pose) = self.poses.front().copied() else { break };
            if !self.step(&pose, context)? {
                break;
            }
            any = true;
        }
        self.commit_again_when_whole(context)?;
        self.stream.drain()?;
        if std::mem::take(&mut self.stream.tiles_wanted) {
            self.republish(context)?;
        }
        if self.uncommitted.is_none()
            && !self.map_closed
            && self.stream.reached(self.acknowledger.done(), context.mode)
        {
            self.close_map()?;
        }
        Ok(any)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.output.tiles.refresh();
        self.output.commits.refresh();
        self.output.submaps.refresh();
        let tiles = self.metrics.look(&self.logic);
        context.report.count("tiles", tiles as u64);
        if !self.parts.is_first() {
            return Ok(());
        }
        self.acknowledger.send()?;
        if self.map_closed { self.repeat_the_end() } else { Ok(()) }
    }

    fn waiting(&self) -> usize {
        self.scans.len()
    }

    fn patience(&self) -> Duration {
        let waits =
            self.waiting_since_ns.is_some() || self.uncommitted.is_some() || self.republishing.is_some();
        Duration::from_millis(if waits { 5 } else { 100 })
    }
}
