//! The shell of scan-matcher: joins scan, verdict, grid and corrections, writes the journal, publishes poses.
//!
//! Of several processes one is active. The others hold the same scans, verdicts and grid and follow its journal, so that one of them
//! goes on with the next scan when it ends.

use crate::{ScanMatcher, Settings};
use corrections::Corrections;
use flockslam_bus::{Publisher, ScanSample, SlicePublisher, Subscriber};
use flockslam_messages::{
    DropReason, FlockRobots, KeepReason, MovingBeamsHeader, PoseEstimate, PoseFlags, Stage, StageStart,
    Verdict,
};
use flockslam_results::ModeWatch;
use flockslam_stage::{
    Actor, Deadline, GridReader, InputLog, Join, JournalReader, JournalWriter, LeaderLock, Mode, Notifiers,
    StageContext, StageError, run, step_aside,
};
use flockslam_telemetry::failpoint;
use metrics::PoseMetrics;
use std::collections::VecDeque;

mod corrections;
mod metrics;
mod odometry_fallback;

pub use odometry_fallback::run_odometry_fallback;

/// Live: deadline of a verdict after its scan. A scan without a verdict is processed.
const VERDICT_DEADLINE_NS: u64 = 20_000_000;
/// Live: so long after a scan the matcher waits awake for the verdict: waking up takes longer.
const VERDICT_POLL_NS: u64 = 300_000;
/// Live: deadline of the commit of an accepted scan.
const COMMIT_DEADLINE_NS: u64 = 100_000_000;
/// Live: accepted scans that the grid may lack. Scans of a burst see about the same, and the older map shows
/// it. With more of them missing, new surfaces could be missed.
const LAG_LIVE: usize = 1;

/// Reason of scans that never reached the matcher.
pub const LOST: &str = "lost";

/// What the stage has to know of the mapper's grid before its first tile.
#[derive(Clone, Copy, Debug)]
pub struct GridFormat {
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Score of a cell without evidence, 0 … 1.
    pub unknown_score: f64,
}

/// Runs the stage until its stop is requested.
///
/// # Errors
/// When the bus or the journal fails.
pub fn run_stage(context: &mut StageContext, settings: Settings, grid: GridFormat) -> Result<(), StageError> {
    let event = context.bus.listener(Stage::ScanMatcher.name())?;
    let lock = LeaderLock::ask(context)?;
    let mut actor = Matcher::open(context, settings, grid)?;
    if !lock.is_ours() && context.mode == Mode::Live {
        actor.grid.request_tiles()?;
    }
    if !lock.stand_by(context, &event, |context| actor.follow(context))? {
        return Ok(());
    }
    actor.begin(context)?;
    run(context, &mut actor, &event)
}

/// The stage as steps, for a caller with a loop of its own.
///
/// # Errors
/// As [`run_stage`].
pub fn shell(
    context: &mut StageContext,
    settings: Settings,
    grid: GridFormat,
) -> Result<Box<dyn Actor>, StageError> {
    let mut actor = Matcher::open(context, settings, grid)?;
    actor.begin(context)?;
    Ok(Box::new(actor))
}

struct Matcher {
    logic: ScanMatcher,
    join: Join<Verdict>,
    corrections: Corrections,
    flock_robots: Subscriber<FlockRobots>,
    /// Robots in the last message about the flock.
    flock_robots_known: u32,
    grid: GridReader,
    inputs: InputLog,
    /// Sequences of the accepted scans whose commits are awaited, and since when, oldest first.
    awaited: VecDeque<(u64, u64)>,
    commit_deadline: Deadline,
    poses: Publisher<PoseEstimate>,
    moving_beams: SlicePublisher<MovingBeamsHeader>,
    /// The journal of the predecessor, up to its last pose.
    past: JournalReader,
    last: Option<PoseEstimate>,
    /// Sequence of the last accepted scan of the journal.
    accepted: Option<u64>,
    /// Open as soon as this process is active.
    journal: Option<JournalWriter>,
    notifiers: Notifiers,
    /// The trajectory, and the sequence of the accepted scan that it began with.
    trajectory: u32,
    trajectory_began: u64,
    /// The others are woken once in so many poses that they only have to count.
    quiet_scans: u64,
    /// Whether the set localizes now.
    mode: ModeWatch,
    /// The set localizes and has not found its place.
    is_unplaced: bool,
    metrics: PoseMetrics,
}

impl Matcher {
    fn open(context: &mut StageContext, settings: Settings, grid: GridFormat) -> Result<Self, StageError> {
        let bus = &context.bus;
        Ok(Self {
            logic: ScanMatcher::new(settings).with_unknown_score(grid.unknown_score),
            join: Join::open(context, VERDICT_DEADLINE_NS)?,
            corrections: Corrections::open(context)?,
            flock_robots: bus.subscriber()?,
            flock_robots_known: 0,
            grid: GridReader::open(context, grid.cell_size_m)?,
            inputs: InputLog::open(context)?,
            awaited: VecDeque::with_capacity(2 + LAG_LIVE),
            commit_deadline: Deadline::live(context.mode, COMMIT_DEADLINE_NS),
            poses: bus.publisher()?,
            moving_beams: bus.slice_publisher()?,
            past: JournalReader::open(&context.journal_dir)?,
            last: None,
            accepted: None,
            journal: None,
            notifiers: Notifiers::open(
                context,
                &[Stage::Mapper, Stage::DynamicCleaner, Stage::SyncManager].map(Stage::name),
            )?,
            trajectory: 0,
            trajectory_began: 0,
            quiet_scans: (context.capacity.window as u64 / 8).max(1),
            mode: ModeWatch::of(&context.result_dir, context.localizes),
            is_unplaced: context.localizes,
            metrics: PoseMetrics::new(&context.metrics),
        })
    }

    /// Follows the active process; gives the number of its new poses.
    fn follow(&mut self, context: &mut StageContext) -> Result<u64, StageError> {
        self.drain(context)?;
        let poses = self.read_journal(context)?;
        self.join.release_before(self.last.map_or(0, |last| last.id.sequence + 1));
        Ok(poses)
    }

    fn read_journal(&mut self, context: &mut StageContext) -> Result<u64, StageError> {
        let mut poses = 0;
        while let Some(record) = self.past.read_next()? {
            context.alive();
            let pose = record.pose;
            if pose.id.sequence >= context.first_sequence && !failpoint("no-resume") {
                self.logic.restore(&pose);
            }
            if pose.has(PoseFlags::INSERT) {
                self.accepted = Some(pose.id.sequence);
                if pose.trajectory != self.trajectory {
                    (self.trajectory, self.trajectory_began) = (pose.trajectory, pose.id.sequence);
                }
            }
            self.last = Some(pose);
            poses += 1;
        }
        Ok(poses)
    }

    /// Goes on after the last pose of the journal, which no other process writes any more.
    fn begin(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.read_journal(context)?;
        self.journal = Some(JournalWriter::open_behind(&context.journal_dir, &self.past)?);
        if failpoint("no-resume") {
            return Ok(());
        }
        let Some(last) = self.last else { return Ok(()) };
        let next = last.id.sequence + 1;
        let is_of_this_session = next > context.first_sequence;
        // A map that was made until now has its robot in it.
        self.is_unplaced = self.mode.localizes() && (last.has(PoseFlags::UNPLACED) || !is_of_this_session);
        if is_of_this_session {
            self.logic.resume(&last);
            self.inputs.resumed(StageStart::Resumed, last.id);
        } else {
            self.logic.resume_detached(&last);
            self.inputs.resumed(StageStart::Continued, last.id);
        }
        if let Some(commit) = self.grid.committed() {
            // The grid is there already: this process followed it.
            self.logic.committed(commit);
        } else {
            self.grid.request_tiles()?;
        }
        if let Some(newer) = self.corrections.last.filter(|newer| newer.revision > last.corrections) {
            self.logic.corrected(&newer);
        }
        // Until that commit the grid is older, or empty.
        self.awaited.extend(self.accepted.map(|sequence| (sequence, context.now_ns())));
        self.accepted.iter().for_each(|sequence| self.corrections.resumed(*sequence));
        // The predecessor may have ended between the journal and this.
        self.poses.send(&last)?;
        self.notifiers.notify();
        self.trajectory = last.trajectory;
        self.join.finished(next)
    }

    fn drain(&mut self, context: &StageContext) -> Result<(), StageError> {
        self.join.drain()?;
        if let Some(commit) = self.grid.drain()? {
            self.logic.committed(&commit);
        }
        self.corrections.drain()?;
        while let Some(correction) = self.corrections.next_due(context.mode, self.next_scan()) {
            self.logic.corrected(&correction);
            self.is_unplaced = correction.attached == 0;
        }
        while let Some(robots) = self.flock_robots.receive()? {
            self.logic.set_flock_robots(&robots);
            self.flock_robots_known = robots.count;
        }
        Ok(())
    }

    /// Sequence of the oldest scan that waits.
    fn next_scan(&self) -> Option<u64> {
        self.join.scans.front().map(|scan| scan.header().id.sequence)
    }

    /// Whether the grid and the correction that the next scan needs are there: in replay all accepted scans in the grid, and
    /// sync-manager not more than a few scans behind.
    fn grid_is_ready(&mut self, context: &mut StageContext) -> bool {
        let committed = self.grid.committed().map(|commit| commit.id.sequence);
        while self.awaited.front().is_some_and(|(sequence, _)| committed >= Some(*sequence)) {
            self.awaited.pop_front();
        }
        // The grid of another trajectory is of no use.
        let may_lag = context.mode == Mode::Live && committed >= Some(self.trajectory_began);
        let lag = if may_lag { LAG_LIVE } else { 0 };
        let oldest = self.awaited.front().filter(|_| self.awaited.len() > lag);
        let Some((_, since_ns)) = oldest else {
            return self.corrections.are_ready(context.mode, self.next_scan());
        };
        let late = self.commit_deadline.is_over(*since_ns, context.now_ns());
        if late {
            self.awaited.pop_front();
            context.dropped(DropReason::Deadline.name());
        }
        late
    }

    /// The verdict on the oldest scan, once it is there or its deadline has passed.
    fn verdict(&mut self, context: &mut StageContext) -> Option<Verdict> {
        let header = *self.join.scans.front()?.header();
        let made =
            |keep, reason| Verdict { id: header.id, times: header.times, coefficient: 0.0, keep, reason };
        // Live and far behind: predicting costs next to nothing, so the newest scans are reached at once.
        if context.mode == Mode::Live && self.join.scans.len() > context.capacity.window / 2 {
            context.dropped(DropReason::Overload.name());
            return Some(made(0, DropReason::Overload as u32));
        }
        self.join.messages.take(header.id.sequence).or_else(|| {
            let late = self.join.is_over(header.times.monotonic_ns, context.now_ns());
            if late {
                context.dropped(DropReason::Deadline.name());
            }
            late.then(|| made(1, KeepReason::Late as u32))
        })
    }

    /// Whether the verdict on the oldest scan should come any moment.
    fn verdict_is_due(&self, context: &StageContext) -> bool {
        let age_ns = |scan: &ScanSample| context.now_ns().saturating_sub(scan.header().times.monotonic_ns);
        let is_young = |scan| age_ns(scan) < VERDICT_POLL_NS;
        context.mode == Mode::Live && self.join.scans.front().is_some_and(is_young)
    }

    fn process(
        &mut self,
        sample: &ScanSample,
        verdict: &Verdict,
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        let (header, started_ns) = (*sample.header(), context.now_ns());
        // Live, a queue that overflows while this process waits for a processor loses its oldest scans.
        for _ in self.join.expected..header.id.sequence {
            context.dropped(LOST);
        }
        let Ok(scan) = sample.view() else {
            context.dropped("unreadable");
            return self.join.finished(header.id.sequence + 1);
        };
        let mut pose = self.logic.handle(scan, verdict, self.grid.grid());
        if self.mode.localizes() {
            pose.flags |= PoseFlags::LOCALIZING | if self.is_unplaced { PoseFlags::UNPLACED } else { 0 };
        }
        let (correction, flock_robots) = (self.corrections.last.unwrap_or_default(), self.flock_robots_known);
        self.inputs.handled(pose.id, &self.grid, |inputs| {
            (inputs.keep, inputs.reason) = (verdict.keep, verdict.reason);
            (inputs.correction, inputs.flock_robots) = (correction, flock_robots);
        })?;
        // An accepted scan is stored outside of this process before its pose is published.
        let journal = self.journal.as_mut().filter(|_| !failpoint("no-journal"));
        let journaled = journal.map(|journal| journal.append(&pose, scan));
        if let Some(Err(error)) = journaled {
            tracing::error!(scan = header.id.sequence, %error, "the journal waits in memory");
            context.dropped("not-journaled");
        }
        self.publish_moving_beams(&pose, context);
        self.poses.send(&pose)?;
        context.handled(header.id.sequence, started_ns, header.times.monotonic_ns);
        self.metrics.published(&pose);
        let accepted = pose.has(PoseFlags::INSERT);
        if accepted {
            self.awaited.push_back((header.id.sequence, context.now_ns()));
            self.corrections.accepted(context.mode, header.id.sequence);
            if pose.trajectory != self.trajectory {
                (self.trajectory, self.trajectory_began) = (pose.trajectory, header.id.sequence);
            }
        }
        if accepted || header.id.sequence.is_multiple_of(self.quiet_scans) {
            self.notifiers.notify();
        }
        context.probe_scan(scan);
        self.join.finished(header.id.sequence + 1)
    }

    /// Moving beams are published before their pose: a stage that has the pose has them too.
    fn publish_moving_beams(&self, pose: &PoseEstimate, context: &mut StageContext) {
        let beams = self.logic.moving_beams();
        if beams.is_empty() {
            return;
        }
        let header =
            MovingBeamsHeader { id: pose.id, times: pose.times, count: beams.len() as u32, reserved: 0 };
        let sent = self.moving_beams.send_with(&header, beams.len(), |to| to.copy_from_slice(beams));
        if let Err(error) = sent {
            tracing::warn!(%error, "moving beams are not published");
            context.dropped("moving-beams-unsent");
        }
    }
}

impl Actor for Matcher {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        self.drain(context)?;
        let (mut any, mut expects_verdict) = (false, false);
        while !self.join.scans.is_empty() && self.grid_is_ready(context) {
            let Some(verdict) = self.verdict(context) else {
                expects_verdict = self.verdict_is_due(context);
                break;
            };
            let Some(sample) = self.join.scans.take(verdict.id.sequence) else { break };
            self.process(&sample, &verdict, context)?;
            any = true;
            drop(sample);
            self.drain(context)?;
        }
        if self.join.has_ended()? && !any {
            self.notifiers.notify();
        }
        if expects_verdict {
            // The filter may wait for this very processor.
            step_aside();
        }
        Ok(any || expects_verdict)
    }

    fn refresh(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        self.poses.refresh();
        self.inputs.refresh();
        self.moving_beams.refresh();
        context.probe_tile(&self.grid);
        self.join.refresh()
    }

    fn waiting(&self) -> usize {
        self.join.scans.len()
    }

    /// A scan waits for its verdict or for the grid.
    fn waits(&self) -> bool {
        !self.join.scans.is_empty()
    }
}

fn last_pose(context: &mut StageContext) -> Result<Option<PoseEstimate>, StageError> {
    let mut journal = JournalReader::open(&context.journal_dir)?;
    let mut last = None;
    while let Some(record) = journal.read_next()? {
        context.alive();
        last = Some(record.pose);
    }
    Ok(last)
}
