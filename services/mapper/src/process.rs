//! The shell of mapper: joins accepted scans with marks, publishes changed tiles and then one commit, stores closed
//! submaps, and rebuilds itself from journal and store when it starts.
//!
//! Of several processes each inserts every scan and publishes its share of the tiles. The first commits for all.

mod metrics;
mod output;
mod parts;
mod unsaved;

use crate::{Mapper, Settings};
use flockslam_bus::SliceSubscriber;
use flockslam_evidence::Submap;
use flockslam_messages::{
    ClearedCell, Commit, ControlKind, DropReason, MarksHeader, PoseEstimate, PoseFlags, ScanView, Stage,
};
use flockslam_stage::{
    Actor, Copies, Deadline, FinalMessage, Inbox, Join, JournalReader, Notifiers, StageContext, StageError,
    Waited, run,
};
use flockslam_telemetry::failpoint;
use metrics::MapMetrics;
use output::Output;
use parts::Parts;
use unsaved::Unsaved;

/// Live: the mapper waits so long for marks; then it inserts the scan without them.
const MARKS_DEADLINE_NS: u64 = 50_000_000;

/// Live: the first mapper waits so long for the tiles of the others; later ones become valid with a later commit.
const PARTS_DEADLINE_NS: u64 = 50_000_000;
/// Counts commits without the tiles of another mapper.
const PART_LATE: &str = "part-late";

/// Runs the stage until its stop is requested.
///
/// # Errors
/// When the bus, the journal or the store fails.
pub fn run_stage(context: &mut StageContext, settings: Settings) -> Result<(), StageError> {
    let event = context.bus.listener(Stage::Mapper.name())?;
    let mut shell = shell(context, settings)?;
    run(context, &mut *shell, &event)
}

/// The stage as steps, for a caller with a loop of its own.
///
/// # Errors
/// As [`run_stage`].
pub fn shell(context: &mut StageContext, settings: Settings) -> Result<Box<dyn Actor>, StageError> {
    let parts = settings.replicas.max(1) as u32;
    if context.replica >= parts {
        return Ok(Box::new(Shareless));
    }
    Ok(Box::new(MapperProcess::open(context, settings, Parts::open(context, parts)?)?))
}

/// A process with a number beyond the shares: it only waits for the end.
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
    /// An insertion whose tiles the others have not sent yet.
    uncommitted: Option<Inserted>,
    commit_deadline: Deadline,
    /// All tiles are sent once more: number of other mappers that have not done it yet.
    republishing: Option<u32>,
    republish_deadline: Deadline,
    unsaved: Unsaved,
    join: Join<PoseEstimate>,
    marks: Inbox<Copies<MarksHeader>>,
    output: Output,
    /// Publishes that the last submap is closed.
    map_closed: FinalMessage,
    /// Accepted scans with a sequence below this are in the map.
    applied: u64,
    /// The map of the predecessor is being rebuilt: readers keep its tiles until all of the new ones are there.
    recovers: bool,
    journal: JournalReader,
    /// Of the last scan in the map.
    last: Option<PoseEstimate>,
    metrics: MapMetrics,
}

/// A scan in the map whose tiles are sent: its commit makes them valid.
struct Inserted {
    commit: Commit,
    /// The submaps that it closed.
    closed: Vec<Submap>,
}

impl MapperProcess {
    fn open(context: &mut StageContext, settings: Settings, parts: Parts) -> Result<Self, StageError> {
        let marks: SliceSubscriber<MarksHeader> = context.bus.slice_subscriber()?;
        let listeners = Notifiers::open(context, &[Stage::SyncManager.name()])?;
        let mut process = Self {
            output: Output::open(context, settings.cell_size_m)?,
            logic: Mapper::of_share(settings, parts.share()),
            uncommitted: None,
            commit_deadline: Deadline::live(context.mode, PARTS_DEADLINE_NS),
            republishing: None,
            republish_deadline: Deadline::new(PARTS_DEADLINE_NS),
            unsaved: Unsaved::new(context),
            join: Join::open(context, MARKS_DEADLINE_NS)?,
            marks: Inbox::unlimited(Copies(marks)),
            map_closed: FinalMessage::open(context, ControlKind::MapClosed, 0, listeners)?,
            applied: 0,
            recovers: false,
            journal: JournalReader::open(&context.journal_dir)?,
            last: None,
            metrics: MapMetrics::new(&context.metrics),
            parts,
        };
        // The first mapper publishes for all.
        process.join.set_acknowledges(process.parts.is_first());
        process.recover(context)?;
        Ok(process)
    }

    /// Rebuilds the map of the predecessor: closed submaps from the store, the active one from the journal.
    fn recover(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        let count = self.unsaved.store().count();
        self.output.resumed_submaps = count;
        let mut inserted = 0;
        for number in 0..count {
            let submap = self.unsaved.store().load(number)?;
            inserted += u64::from(submap.insertions);
            self.applied = submap.last + 1;
            if self.parts.is_first() {
                self.output.publish_submap(&self.unsaved.store().notice(&submap)?)?;
            }
            self.logic.resume(submap, inserted);
            context.alive();
        }
        if failpoint("replay-twice") {
            self.applied = 0;
        }
        self.recovers = true;
        self.catch_up(u64::MAX, context)?;
        self.recovers = false;
        self.republish(context)?;
        self.join.finished(self.join.expected)
    }

    /// Applies accepted scans of the journal before this sequence that are not in the map yet.
    fn catch_up(&mut self, before: u64, context: &mut StageContext) -> Result<(), StageError> {
        while let Some(record) = self.journal.read_before(before)?.filter(|_| !failpoint("no-replay")) {
            context.alive();
            self.join.expected = self.join.expected.max(record.pose.id.sequence + 1);
            if record.pose.has(PoseFlags::LOCALIZING) && record.pose.id.sequence < self.applied {
                self.logic.has_localized(record.pose.id.sequence);
            }
            let is_new = record.pose.id.sequence >= self.applied;
            if record.pose.has(PoseFlags::INSERT) && !is_new {
                // The grid of closed submaps is committed with the last of their scans: the active one may have none yet.
                self.last = Some(record.pose);
            }
            let Some(scan) = record.scan.filter(|_| is_new) else { continue };
            let Ok(scan) = scan.view() else { continue };
            match self.apply(scan, &record.pose, &[])? {
                Some(inserted) if self.recovers => self.store(inserted.closed)?,
                // The others' tiles of it become valid with a later commit.
                Some(inserted) => self.commit(inserted)?,
                None => {}
            }
        }
        Ok(())
    }

    /// Inserts a scan and sends the changed tiles. The first mapper gets what is to be committed; the others tell it that their tiles
    /// are sent.
    fn apply(
        &mut self,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        cleared: &[ClearedCell],
    ) -> Result<Option<Inserted>, StageError> {
        assert!(pose.id.sequence >= self.applied, "a scan enters the map once");
        let insertion = self.logic.insert(scan, pose, cleared);
        let commit = Commit {
            id: pose.id,
            times: pose.times,
            generation: insertion.generation,
            tiles: insertion.changed.len() as u32,
            active_submap: insertion.active_submap,
            cleared: cleared.len() as u32,
            ..Commit::default()
        };
        let (closed, tiles) = (insertion.closed, insertion.changed.len());
        if !self.recovers {
            self.output.unsent.extend_from_slice(insertion.changed);
            self.output.retire(insertion.retired, commit.generation)?;
            self.output.send_tiles(&self.logic, commit.generation)?;
        }
        self.applied = pose.id.sequence + 1;
        self.last = Some(*pose);
        if self.parts.is_first() {
            return Ok(Some(Inserted { commit, closed }));
        }
        self.logic.take_cleared();
        if !self.recovers {
            self.parts.publish(pose, tiles, false)?;
        }
        Ok(None)
    }

    /// Commits the last insertion when all mappers have sent their tiles, or, live, after the deadline; false while it waits.
    fn commit_when_whole(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let Some(Inserted { commit, .. }) = &mut self.uncommitted else { return Ok(true) };
        if self.parts.others() > 0 {
            self.parts.drain()?;
            match self.parts.have_inserted(commit.id.sequence) {
                Some(tiles) => commit.tiles += tiles,
                None if self.commit_deadline.passes(context.now_ns()) => context.dropped(PART_LATE),
                None => return Ok(false),
            }
        }
        self.commit_deadline.end();
        self.uncommitted.take().map_or(Ok(()), |inserted| self.commit(inserted))?;
        Ok(true)
    }

    /// Makes the tiles of an insertion valid. Then, while no stage waits, closed submaps are stored.
    fn commit(&mut self, inserted: Inserted) -> Result<(), StageError> {
        self.output.commit(&inserted.commit)?;
        self.store(inserted.closed)
    }

    /// Stores closed submaps, and again those in which cells were cleared since.
    fn store(&mut self, closed: impl IntoIterator<Item = Submap>) -> Result<(), StageError> {
        closed.into_iter().for_each(|submap| self.unsaved.add(submap, true));
        self.logic.take_cleared().into_iter().for_each(|submap| self.unsaved.add(submap, false));
        if self.unsaved.is_refused() { Ok(()) } else { self.unsaved.save(&self.output) }
    }

    /// Sends all live tiles and the last commit again: a reader has started and holds none.
    fn republish(&mut self, context: &StageContext) -> Result<(), StageError> {
        let Some(last) = self.last else { return Ok(()) };
        self.send_all_tiles()?;
        if !self.parts.is_first() {
            return self.parts.publish(&last, self.logic.live_tiles().count(), true);
        }
        if self.parts.others() > 0 {
            self.republishing = Some(self.parts.others());
            self.republish_deadline.end();
            return Ok(());
        }
        self.commit_again(context)
    }

    /// Commits all tiles again once every mapper has sent its own, or the deadline has passed.
    fn commit_again_when_whole(&mut self, context: &StageContext) -> Result<(), StageError> {
        // The first commits for all; the others receive their own messages, too.
        if self.parts.others() == 0 || !self.parts.is_first() {
            return Ok(());
        }
        self.parts.drain()?;
        let republished = self.parts.take_republished();
        let late = match &mut self.republishing {
            Some(missing) => {
                *missing = missing.saturating_sub(republished);
                *missing == 0 || self.republish_deadline.passes(context.now_ns())
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
        self.output.send_tiles(&self.logic, self.logic.generation())
    }

    fn commit_again(&mut self, context: &StageContext) -> Result<(), StageError> {
        let Some(last) = self.last else { return Ok(()) };
        let commit = Commit {
            id: last.id,
            times: last.times,
            generation: self.logic.generation(),
            tiles: self.logic.live_tiles().count() as u32,
            active_submap: self.logic.active_submap(),
            all_tiles: 1,
            ..Commit::default()
        };
        self.output.commit(&commit)?;
        context.bus.notifier(Stage::DynamicCleaner.name())?.notify();
        Ok(())
    }

    /// Handles the oldest pose; false when its join is not complete.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        let sequence = pose.id.sequence;
        if self.join.has_missed(sequence) {
            // Poses were missed while this process was held up; the journal has the accepted scans.
            self.catch_up(sequence, context)?;
        }
        if !pose.has(PoseFlags::INSERT) || sequence < self.applied {
            context.passed_over();
            self.join.finished(sequence + 1)?;
            return Ok(true);
        }
        self.marks.drain()?;
        let cleared = match self.join.wait(self.marks.take(sequence), context.now_ns()) {
            Waited::For((_, cleared)) => cleared,
            Waited::TooLong => {
                context.dropped(DropReason::Deadline.name());
                Vec::new()
            }
            Waited::NotYet => return Ok(false),
        };
        let started_ns = context.now_ns();
        let sample = self.join.scans.take(sequence);
        match sample.as_ref().and_then(|sample| sample.view().ok()) {
            Some(scan) => {
                context.probe_scan(scan);
                self.uncommitted = self.apply(scan, pose, &cleared)?;
            }
            // The scan was sent before this process listened; the journal has every accepted scan.
            None => self.catch_up(sequence + 1, context)?,
        }
        self.metrics.inserted(sequence, cleared.len());
        context.handled(sequence, started_ns, pose.times.monotonic_ns);
        self.join.finished(sequence + 1)?;
        Ok(true)
    }

    fn close_map(&mut self) -> Result<(), StageError> {
        let last = self.logic.close();
        self.store(last)?;
        // What a full disk refuses is tried again first.
        if self.unsaved.is_refused() {
            return Ok(());
        }
        self.map_closed.send(u64::from(self.unsaved.store().count()))
    }
}

impl Actor for MapperProcess {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        let mut any = false;
        while self.commit_when_whole(context)? {
            let Some(pose) = self.join.oldest()? else { break };
            if !self.step(&pose, context)? {
                break;
            }
            any = true;
        }
        self.commit_again_when_whole(context)?;
        let ended = self.join.has_ended()?;
        if std::mem::take(&mut self.join.stream.tiles_wanted) {
            self.republish(context)?;
        }
        let may_close = self.parts.is_first()
            && self.uncommitted.is_none()
            && !self.map_closed.is_sent()
            && !self.unsaved.is_refused();
        if ended && may_close {
            self.close_map()?;
        }
        Ok(any)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.output.refresh();
        if self.unsaved.is_refused() {
            self.unsaved.save(&self.output)?;
        }
        let tiles = self.metrics.look(&self.logic);
        context.report.count("tiles", tiles as u64);
        self.join.refresh()?;
        self.map_closed.repeat()
    }

    fn waiting(&self) -> usize {
        self.join.scans.len()
    }

    fn waits(&self) -> bool {
        self.join.waits() || self.uncommitted.is_some() || self.republishing.is_some()
    }
}
