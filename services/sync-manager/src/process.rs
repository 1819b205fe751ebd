//! The shell of sync-manager: joins poses, accepted scans and closed submaps, publishes corrections, and at the end
//! stores the final trajectory and the fused map.
//!
//! Of several processes one is active. The others read the same inputs and compute the same results without publishing them, so that one of them
//! goes on when it ends: recovering its state would take as long as all its searches.

use crate::pose_record::gives_a_place;
use crate::{BackEnd, ClosureCounts, Settings};
use clear_at_end::clear_at_end;
use detached::write_detached;
use flock_outbox::Outbox;
use flockslam_bus::{Notifier, Publisher, SUPERVISOR_EVENT, Subscriber};
use flockslam_flock_network::FlockMetrics;
use flockslam_messages::{
    BeamRange, ControlKind, Correction, FlockFrame, FlockRobots, LocalisationOrder, MovingBeamsHeader,
    PoseEstimate, PoseFlags, ScanView, Stage, SubmapClosed,
};
use flockslam_results::SubmapStore;
use flockslam_results::{self as results, LocalisationStatus, Summary, Unattached};
use flockslam_stage::{
    Actor, Copies, FinalMessage, Inbox, Join, JournalReader, LeaderLock, Mode, Notifiers, StageContext,
    StageError, run,
};
use fuser::Fuser;
use metrics::CorrectionMetrics;
use mode_turn::{LocalStretches, back_end, localizes};
use recovery::{Silence, is_deaf};
use std::collections::BTreeMap;
use std::path::PathBuf;
use trajectories::Trajectories;

mod clear_at_end;
mod detached;
mod flock_outbox;
mod fuser;
mod live_solution;
mod localized;
mod metrics;
mod mode_turn;
mod recovery;
mod trajectories;

/// Runs the stage until its stop is requested.
///
/// # Errors
/// When the bus, the journal or the store fails.
pub fn run_stage(context: &mut StageContext, settings: Settings) -> Result<(), StageError> {
    let event = context.bus.listener(Stage::SyncManager.name())?;
    let lock = LeaderLock::ask(context)?;
    if context.mode == Mode::Exact && !lock.stand_by(context, &event, |_| Ok(0))? {
        return Ok(());
    }
    let mut actor = SyncProcess::open(context, settings, lock)?;
    run(context, &mut actor, &event)
}

/// The stage as steps, for a caller with a loop of its own.
///
/// # Errors
/// As [`run_stage`].
pub fn shell(context: &mut StageContext, settings: Settings) -> Result<Box<dyn Actor>, StageError> {
    let lock = LeaderLock::ask(context)?;
    Ok(Box::new(SyncProcess::open(context, settings, lock)?))
}

struct SyncProcess {
    logic: BackEnd,
    lock: LeaderLock,
    /// This process is the active one; otherwise it is on standby.
    is_active: bool,
    /// The last conclusion.
    correction: Option<Correction>,
    /// Time that conclusions have taken since the last closed submap, nanoseconds.
    took_ns: u64,
    /// Scans are given to the logic, which computes new poses for them.
    optimises: bool,
    /// Live: the present solution is written to the results for readers.
    is_watched: bool,
    result_dir: PathBuf,
    store: SubmapStore,
    fuser: Fuser,
    join: Join<PoseEstimate>,
    moving_beams: Inbox<Copies<MovingBeamsHeader>>,
    journal: JournalReader,
    submaps: Subscriber<SubmapClosed>,
    orders: Subscriber<LocalisationOrder>,
    /// Closed submaps that the logic has not seen, by number.
    waiting_submaps: BTreeMap<u32, SubmapClosed>,
    /// The logic has seen all submaps below this.
    next_submap: u32,
    corrections: Publisher<Correction>,
    matcher: Notifier,
    finished: FinalMessage,
    trajectories: Trajectories,
    settings: Settings,
    /// Publishes this robot's findings to the flock.
    outbox: Outbox,
    /// Metrics of the outbox, until it is opened.
    flock_metrics: Option<FlockMetrics>,
    flock_frames: Publisher<FlockFrame>,
    flock_frame: Option<FlockFrame>,
    flock_robots: Publisher<FlockRobots>,
    /// Their poses as published last.
    published_robots: FlockRobots,
    /// The last one taken in.
    pose: Option<PoseEstimate>,
    summary: Summary,
    /// The state of a predecessor is recovered.
    recovered: bool,
    /// Since when no pose has been received.
    silence: Silence,
    /// Scans that the set has localized with, while a map is made.
    local: LocalStretches,
    metrics: CorrectionMetrics,
    /// Trajectories without a connection to the map, as logged last.
    unattached: Unattached,
    /// The belief about the pose in a known map, as published last.
    localisation: Option<LocalisationStatus>,
}

impl SyncProcess {
    fn open(context: &mut StageContext, settings: Settings, lock: LeaderLock) -> Result<Self, StageError> {
        let is_active = lock.is_ours();
        let own = context.result_dir.join(format!("{}-{}", context.stage.name(), context.replica));
        let result_dir = if is_active { context.result_dir.clone() } else { own };
        std::fs::create_dir_all(&result_dir).map_err(|e| StageError::file(&result_dir, e))?;
        let bus = &context.bus;
        let supervisor = Notifiers::open(context, &[SUPERVISOR_EVENT])?;
        let mut process = Self {
            optimises: settings.enabled,
            is_watched: context.mode == Mode::Live,
            result_dir: context.result_dir.clone(),
            fuser: Fuser::new(SubmapStore::new(&context.submap_dir), &settings),
            logic: back_end(context, &settings, localizes(context))?,
            lock,
            is_active,
            correction: None,
            took_ns: 0,
            store: SubmapStore::new(&context.submap_dir),
            join: Join::open(context, 0)?,
            moving_beams: Inbox::unlimited(Copies(bus.slice_subscriber()?)),
            journal: JournalReader::open(&context.journal_dir)?,
            submaps: bus.subscriber()?,
            orders: bus.subscriber()?,
            waiting_submaps: BTreeMap::new(),
            next_submap: 0,
            corrections: bus.publisher()?,
            matcher: bus.notifier(Stage::ScanMatcher.name())?,
            finished: FinalMessage::open(context, ControlKind::Finished, 0, supervisor)?,
            trajectories: Trajectories::create(&result_dir)?,
            settings,
            outbox: Outbox::Silent,
            flock_metrics: Some(FlockMetrics::new(&context.metrics)),
            flock_frames: bus.publisher()?,
            flock_frame: None,
            flock_robots: bus.publisher()?,
            published_robots: FlockRobots::default(),
            pose: None,
            summary: Summary::default(),
            recovered: false,
            silence: Silence::new(context.mode),
            local: LocalStretches::default(),
            metrics: CorrectionMetrics::new(&context.metrics),
            unattached: Unattached::default(),
            localisation: None,
        };
        process.join.set_acknowledges(is_active);
        if process.is_active {
            process.open_outbox(context)?;
        }
        process.recover(context)?;
        Ok(process)
    }

    /// From now on this process publishes to the flock.
    fn open_outbox(&mut self, context: &StageContext) -> Result<(), StageError> {
        if let Some(metrics) = self.flock_metrics.take() {
            self.outbox =
                Outbox::open(&self.settings.flock, &context.result_dir, &context.status_dir, metrics)?;
        }
        Ok(())
    }

    /// The active process is gone: this one takes over. It begins by publishing the last correction again, which may have been lost.
    fn take_over(&mut self, context: &StageContext) -> Result<(), StageError> {
        tracing::info!(stage = context.stage.name(), replica = context.replica, "takes over");
        self.trajectories.move_to(&context.result_dir)?;
        self.is_active = true;
        self.join.set_acknowledges(true);
        self.open_outbox(context)?;
        if let Some(mapping) = self.logic.mapping() {
            for number in 0..self.next_submap {
                self.outbox.publish(mapping, number, &self.store)?;
            }
        }
        if let Some(correction) = &self.correction {
            self.corrections.send(correction)?;
            self.matcher.notify();
        }
        self.join.refresh()
    }

    fn take_in(
        &mut self,
        pose: &PoseEstimate,
        scan: Option<ScanView<'_>>,
        moving: &[BeamRange],
        context: &StageContext,
    ) -> Result<(), StageError> {
        self.pose = Some(*pose);
        let is_local = pose.has(PoseFlags::LOCALIZING);
        if self.logic.localizing().is_some() && pose.id.sequence < context.first_sequence {
            // It was driven in another session: where the robot is now does not follow from it.
            return Ok(());
        }
        if !pose.has(PoseFlags::IMPORTED) {
            self.trajectories.published(pose);
            self.summary.count(pose);
        }
        if let Some(localizing) = self.logic.localizing().filter(|_| !self.recovered || !is_local) {
            localizing.published(pose);
            return Ok(());
        }
        self.logic.pose(pose);
        if let Some(mapping) = self.logic.mapping().filter(|_| is_local) {
            self.local.add(pose.id.sequence);
            self.trajectories.frozen(&[mapping.localized(pose)]);
            return Ok(());
        }
        self.local.end();
        if let Some(scan) = scan.filter(|_| self.optimises && gives_a_place(pose)) {
            self.logic.node(scan, pose, moving);
        }
        Ok(())
    }

    /// The pose and the points of a scan have been handed to the logic: corrects the front end when the scan has entered the map. In
    /// replay the front end waits for this word, so it is given though nothing is new.
    fn accepted(&mut self, pose: &PoseEstimate, context: &StageContext) -> Result<(), StageError> {
        let localizes = pose.has(PoseFlags::LOCALIZING) || self.logic.localizing().is_some();
        if !pose.has(PoseFlags::INSERT) || (localizes && self.is_watched) {
            return Ok(());
        }
        let started_ns = context.now_ns();
        let correction = self.logic.scan_accepted(pose.id);
        self.took_ns += context.now_ns().saturating_sub(started_ns);
        let is_new = self.correction.is_none_or(|last| last.revision != correction.revision);
        self.correction = Some(correction);
        if is_new || !self.is_watched { self.correct(&correction) } else { Ok(()) }
    }

    /// Hands a closed submap to the logic and publishes the correction. In replay corrections come after scans only.
    fn conclude(&mut self, notice: &SubmapClosed, context: &StageContext) -> Result<(), StageError> {
        let started_ns = context.now_ns();
        if let Some(mapping) = self.logic.mapping().filter(|_| self.local.holds(notice.last.sequence)) {
            mapping.leave_out(notice.number);
            self.next_submap = notice.number + 1;
            return Ok(());
        }
        let correction = self.logic.submap_closed(notice);
        let took_ns = context.now_ns().saturating_sub(started_ns) + std::mem::take(&mut self.took_ns);
        self.next_submap = notice.number + 1;
        self.correction = Some(correction);
        if self.is_watched {
            self.correct(&correction)?;
        }
        let Some(mapping) = self.logic.mapping() else { return Ok(()) };
        self.trajectories.frozen(&mapping.take_frozen());
        self.outbox.publish(mapping, notice.number, &self.store)?;
        if !self.is_active {
            self.metrics.recovered(mapping.closure_counts());
            return Ok(());
        }
        self.fuser.keep_below(mapping.imported_submaps());
        let retired = self.fuser.follow(&mapping.submap_poses(), self.next_submap)?;
        mapping.submaps_retired(&retired);
        let (counts, unattached) = (mapping.closure_counts(), mapping.unattached());
        self.publish(took_ns, counts);
        self.report_unattached(unattached, context);
        self.show();
        Ok(())
    }

    /// Gives the front end a correction. What a predecessor of a live set has given already is over.
    fn correct(&mut self, correction: &Correction) -> Result<(), StageError> {
        if self.is_active && (self.recovered || !self.is_watched) {
            self.corrections.send(correction)?;
            self.matcher.notify();
        }
        Ok(())
    }

    /// Concludes the stored submaps below this number that are due; false if one is not stored yet.
    fn conclude_stored(&mut self, below: u32, context: &StageContext) -> Result<bool, StageError> {
        while self.next_submap < below {
            if !self.store.has(self.next_submap) {
                return Ok(false);
            }
            let submap = self.store.load(self.next_submap)?;
            self.conclude(&self.store.notice(&submap)?, context)?;
        }
        Ok(true)
    }

    fn publish(&mut self, took_ns: u64, counts: ClosureCounts) {
        let (scan, submap) = (self.join.expected, self.next_submap.saturating_sub(1));
        tracing::debug!(
            scan,
            submap,
            accepted = counts.accepted,
            revoked = counts.revoked,
            took_ns,
            "concluded"
        );
        if !self.recovered {
            // The predecessor has counted it already.
            self.metrics.recovered(counts);
        }
        self.metrics.concluded(counts, took_ns, self.fuser.area_m2());
    }

    fn drain_submaps(&mut self) -> Result<(), StageError> {
        while let Some(notice) = self.submaps.receive()? {
            if notice.number >= self.next_submap {
                self.waiting_submaps.insert(notice.number, *notice);
            }
        }
        Ok(())
    }

    /// Handles the oldest pose; false when its join is not complete. A submap is concluded at a fixed place: before the first
    /// scan that enters a later one. A live set does not wait for its notice: the mapper may have sent that before this process was
    /// there, or was killed before.
    fn step(&mut self, pose: &PoseEstimate, context: &mut StageContext) -> Result<bool, StageError> {
        let sequence = pose.id.sequence;
        if self.join.has_missed(sequence) {
            // Poses were missed while this process was held up; the journal has them.
            self.catch_up(sequence, context)?;
        }
        while self.next_submap < pose.submap && pose.has(PoseFlags::INSERT) {
            if let Some(notice) = self.waiting_submaps.remove(&self.next_submap) {
                self.conclude(&notice, context)?;
            } else if context.mode == Mode::Exact {
                return Ok(false);
            } else if !self.conclude_stored(self.next_submap + 1, context)? {
                break;
            }
        }
        let started_ns = context.now_ns();
        let sample = self.join.scans.take(sequence);
        let stored =
            if sample.is_none() && pose.has(PoseFlags::INSERT) { self.stored_scan(sequence)? } else { None };
        let received = sample.as_ref().and_then(|sample| sample.view().ok());
        let scan = received.or(stored.as_ref().and_then(|scan| scan.view().ok()));
        scan.into_iter().for_each(|scan| context.probe_scan(scan));
        // They were sent before their pose, so they have arrived.
        self.moving_beams.drain()?;
        let moving = self.moving_beams.take(sequence).map_or_else(Vec::new, |(_, beams)| beams);
        self.turn_to(pose, context)?;
        self.take_in(pose, scan, &moving, context)?;
        self.localized(context)?;
        self.accepted(pose, context)?;
        if self.is_active {
            context.handled(sequence, started_ns, pose.times.monotonic_ns);
        } else {
            context.followed(1);
        }
        self.join.finished(sequence + 1)?;
        Ok(true)
    }

    /// Publishes the poses of the other robots to the stages, and this robot's pose to the other robots.
    fn publish_robots(&mut self) -> Result<(), StageError> {
        if let Some(pose) = &self.pose {
            self.outbox.is_at(pose);
        }
        let robots = self.outbox.robots();
        if robots != self.published_robots {
            self.published_robots = robots;
            self.flock_robots.send(&robots)?;
        }
        self.flock_robots.refresh();
        Ok(())
    }

    fn finish(&mut self, context: &mut StageContext) -> Result<(), StageError> {
        // In replay none is missed, and the journal need not be read once more.
        if self.is_watched {
            self.read_on(context)?;
        }
        self.conclude_stored(u32::MAX, context)?;
        let directory = &context.result_dir.clone();
        let Some(mapping) = self.logic.mapping() else { return self.finish_localizing(directory) };
        let solution = mapping.finish();
        mapping.drop_scans();
        let scans = self.trajectories.finish(&solution)?;
        self.fuser.keep_below(mapping.imported_submaps());
        self.fuser.finish(&solution.submaps)?;
        if self.settings.clear_at_end {
            clear_at_end(&mut self.fuser, &solution.submaps, &scans, self.summary.inserted, context)?;
        }
        self.fuser.write_map(directory)?;
        self.summary.detached = write_detached(&solution, &scans, &self.store, context)?;
        self.summary.scans_apart = self.local.scans();
        self.summary.submaps = self.fuser.known(&solution.submaps);
        self.fuser.report(&mut self.summary);
        self.summary.trajectories = solution.closures.trajectories;
        self.summary.detached_scans = solution.closures.detached_scans;
        self.summary.closures_tried = solution.closures.searches;
        self.summary.closures_accepted = solution.closures.accepted;
        self.summary.closures_revoked = solution.closures.revoked;
        results::write_summary(directory, &self.summary)?;
        if let Some(mapping) = self.logic.mapping() {
            self.outbox.finish(mapping, &solution, &self.store, &scans, context)?;
        }
        self.finished.send(self.summary.scans)
    }
}

impl Actor for SyncProcess {
    fn advance(&mut self, context: &mut StageContext) -> Result<bool, StageError> {
        if !self.is_active && self.lock.is_ours() {
            self.take_over(context)?;
        }
        self.obey()?;
        let mut any = false;
        while let Some(pose) = self.join.oldest()?.filter(|_| !is_deaf(context)) {
            self.drain_submaps()?;
            if !self.step(&pose, context)? {
                break;
            }
            any = true;
        }
        self.listen(any, context)?;
        let ended = self.join.has_ended()? && self.join.stream.submaps.is_some();
        if ended && self.is_active && !self.finished.is_sent() {
            self.finish(context)?;
        }
        Ok(any)
    }

    fn waiting(&self) -> usize {
        self.join.scans.len()
    }

    fn refresh(&mut self, _context: &mut StageContext) -> Result<(), StageError> {
        self.corrections.refresh();
        if !self.is_active {
            return Ok(());
        }
        let frame = self.outbox.frame();
        if frame != self.flock_frame {
            self.flock_frame = frame;
            frame.iter().try_for_each(|frame| self.flock_frames.send(frame))?;
        }
        self.flock_frames.refresh();
        self.publish_robots()?;
        self.join.refresh()?;
        self.finished.repeat()
    }
}
