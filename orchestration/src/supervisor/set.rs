//! A running process set: it starts the stages, watches them, restarts those that ended or hung, and stops all of them.

use super::child::{StageChild, StartOrder};
use super::hang::HangWatch;
use super::set_error::{READY_LIMIT, SetError};
use super::status::{SetState, SetStatus, StageState, StageStatus};
use super::{ProcessLimits, SetFile, Supervision, system_limits};
use crate::configuration::Configuration;
use flockslam_bus::{Bus, BusError, Notifier, OrphanedNodes, Publisher, RuntimeDir, Subscriber};
use flockslam_lidar_ingest::process::read_lidar_lines;
use flockslam_messages::{Control, ControlKind, LocalisationOrder, Progress, Stage};
use flockslam_results::{FlockStatus, LidarStatus, LocalisationStatus, Unattached};
use flockslam_stage::{Mode, Pause};
use flockslam_telemetry::{SupervisorMetrics, monotonic_ns};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::Signal;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::time::{Duration, Instant};

mod set_durability;
mod set_localisation;
mod set_log_levels;
mod set_scaling;

/// Exit code of a stage whose source is not usable: a mistake of the user's.
pub const EXIT_BAD_SOURCE: i32 = 2;
const STOP_LIMIT: Duration = Duration::from_secs(2);
/// What a set that lives knows is outside of its stages, so none of them is waited for.
const STOP_LIMIT_LIVE: Duration = Duration::from_millis(500);
/// Reports of processes that are kept for each stage.
const REPORTS_MAX: usize = 64;
const CLEAN_PERIOD: Duration = Duration::from_secs(1);

/// What happened in a running set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetEvent {
    /// Nothing new.
    Quiet,
    /// The matcher has finished with this many scans.
    Progress(u64),
    /// The final solution and map are stored.
    Finished,
}

/// The processes of one robot, their shared memory and their state outside of them.
pub struct ProcessSet {
    children: Vec<StageChild>,
    progress: Subscriber<Progress>,
    control: Subscriber<Control>,
    metrics: SupervisorMetrics,
    orders: Publisher<Control>,
    localisation_orders: Publisher<LocalisationOrder>,
    source_notifier: Notifier,
    set: SetFile,
    supervision: Supervision,
    hang_watch: HangWatch,
    executable: PathBuf,
    started: Instant,
    cleaned: Instant,
    orphans: OrphanedNodes,
    /// Why something waits in memory that should be in a file.
    not_durable: Option<String>,
    // The bus goes before the directory that it is in.
    bus: Bus,
    runtime: RuntimeDir,
}

impl ProcessSet {
    /// Creates shared memory in a directory, which may hold what an earlier set knew, and starts all stages: consumers first, the
    /// source when everybody listens.
    ///
    /// # Errors
    /// When shared memory cannot be prepared, or a stage cannot be started.
    pub fn start(runtime: RuntimeDir, set: SetFile, supervision: Supervision) -> Result<Self, SetError> {
        let executable =
            std::env::current_exe().map_err(|source| SetError::Start { stage: "flockslam", source })?;
        system_limits::check(&set.configuration, &set.options)?;
        let bus = Bus::host(&runtime, set.options.capacity())?;
        set.write(&runtime.configuration())?;
        let mut started = Self {
            children: children(&set),
            progress: bus.subscriber()?,
            control: bus.subscriber()?,
            metrics: SupervisorMetrics::new(&Stage::ALL.map(Stage::name)),
            orders: bus.publisher()?,
            localisation_orders: bus.publisher()?,
            source_notifier: bus.notifier(Stage::LidarIngest.name())?,
            executable,
            started: Instant::now(),
            cleaned: Instant::now(),
            orphans: OrphanedNodes::default(),
            not_durable: None,
            hang_watch: HangWatch::default(),
            supervision,
            set,
            bus,
            runtime,
        };
        started.start_stages()?;
        Ok(started)
    }

    fn start_stages(&mut self) -> Result<(), SetError> {
        let (source, consumers): (Vec<_>, Vec<_>) =
            (0..self.children.len()).partition(|at| self.children[*at].stage == Stage::LidarIngest);
        for at in &consumers {
            self.spawn(*at)?;
        }
        self.wait_until_ready(&consumers)?;
        for at in source {
            self.spawn(at)?;
        }
        Ok(())
    }

    fn spawn(&mut self, at: usize) -> Result<(), SetError> {
        let child = &mut self.children[at];
        let given = self.supervision.limits(child.stage);
        let nice = given.nice.or(Some(niceness(child.stage, self.set.options.mode)));
        let limits = ProcessLimits { nice, ..given };
        let order =
            StartOrder { executable: &self.executable, set_dir: self.runtime.path(), limits: &limits };
        prune_reports(&self.runtime.status(), child.stage);
        child.start(&order).map_err(|source| SetError::Start { stage: child.stage.name(), source })
    }

    fn wait_until_ready(&mut self, children: &[usize]) -> Result<(), SetError> {
        let deadline = Instant::now() + READY_LIMIT;
        for at in children {
            while !self.children[*at].beat(&self.runtime.status()).is_some_and(|beat| beat.ready) {
                if self.goes_on() {
                    self.look_after()?;
                } else if let Some(status) = self.children[*at].reap() {
                    return Err(self.ended(self.children[*at].stage, status));
                }
                if Instant::now() > deadline || self.children[*at].is_given_up() {
                    if self.supervision.live {
                        // The others do without it.
                        break;
                    }
                    return Err(SetError::NotReady(self.children[*at].stage.name()));
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        Ok(())
    }

    /// Restarts stages that have ended, replaces those that hang, and frees resources of dead processes.
    fn look_after(&mut self) -> Result<(), SetError> {
        self.handle_deaths()?;
        if self.goes_on() {
            self.look_for_work();
        }
        if self.supervision.live {
            self.look_for_hangs();
        }
        if self.cleaned.elapsed() > CLEAN_PERIOD {
            self.clean();
            self.look_for_durability();
        }
        Ok(())
    }

    /// Whether stages that end are restarted; exact replay waits for each stage and ends with it.
    fn goes_on(&self) -> bool {
        self.set.options.mode == Mode::Live
    }

    fn look_for_work(&mut self) {
        let status_dir = self.runtime.status();
        for child in &mut self.children {
            child.retry_when_due();
            if child.note_work(&status_dir) {
                tracing::info!(stage = child.stage.name(), "works again");
                self.metrics.set_degraded(child.stage.name(), false);
            }
        }
    }

    fn look_for_hangs(&mut self) {
        let (now_ns, status_dir) = (monotonic_ns(), self.runtime.status());
        let may_kill_hung = self.hang_watch.look(now_ns);
        for child in &mut self.children {
            let stage = child.stage;
            let deadline = self.supervision.limits(stage).deadline(stage);
            if may_kill_hung && child.kill_if_it_hangs(&status_dir, now_ns, deadline) {
                tracing::warn!(stage = stage.name(), "gives no sign of life and is replaced");
                self.metrics.hung(stage.name());
            }
        }
    }

    /// Waits up to `limit` for an event; restarts stages that have ended.
    ///
    /// # Errors
    /// When the set cannot go on.
    pub fn watch(&mut self, limit: Duration) -> Result<SetEvent, SetError> {
        self.wait_for_deaths(limit);
        self.look_after()?;
        match self.receive() {
            // A publisher that was killed while it was made may be seen half; it is cleaned up, and the set lives on.
            Err(error) if self.goes_on() => {
                tracing::warn!(%error, "a message of a stage was not received");
                Ok(SetEvent::Quiet)
            }
            received => Ok(received?),
        }
    }

    /// Takes in what the stages have said.
    fn receive(&mut self) -> Result<SetEvent, BusError> {
        let mut event = SetEvent::Quiet;
        while let Some(progress) = self.progress.receive()? {
            if progress.stage == Stage::ScanMatcher as u32 {
                event = SetEvent::Progress(progress.done);
            }
        }
        while let Some(control) = self.control.receive()? {
            if control.kind == ControlKind::Finished as u32 {
                event = SetEvent::Finished;
            }
        }
        Ok(event)
    }

    fn wait_for_deaths(&self, limit: Duration) {
        let mut watched: Vec<_> = self
            .children
            .iter()
            .filter_map(|child| child.death().map(|death| PollFd::new(death, PollFlags::IN)))
            .collect();
        let timeout = limit.try_into().expect("a limit of seconds fits");
        // Interrupted by a signal: the caller looks around anyway.
        let _ = poll(&mut watched, Some(&timeout));
    }

    fn handle_deaths(&mut self) -> Result<(), SetError> {
        for at in 0..self.children.len() {
            if let Some(status) = self.children[at].reap() {
                let stage = self.children[at].stage;
                // At once: what the dead process held would block others.
                self.clean();
                let bad_source = stage == Stage::LidarIngest && status.code() == Some(EXIT_BAD_SOURCE);
                if bad_source || !self.goes_on() {
                    return Err(self.ended(stage, status));
                }
                tracing::warn!(stage = stage.name(), how = describe(status), "restarting");
                if !self.children[at].plan_restart(&self.runtime.status()) {
                    self.give_up(at, status)?;
                }
            }
            if self.children[at].is_due() {
                self.spawn(at)?;
                let why = self.children[at].take_restart_reason();
                self.metrics.restarted(self.children[at].stage.name(), why);
            }
        }
        Ok(())
    }

    /// A stage does not get up: the set goes on without, a run only as long as there is hope.
    fn give_up(&mut self, at: usize, status: ExitStatus) -> Result<(), SetError> {
        let how = self.reason(self.children[at].stage, status);
        let child = &mut self.children[at];
        let stage = child.stage.name();
        if self.supervision.retries_max.is_some_and(|retries| !child.may_get_up(retries)) {
            return Err(SetError::GivenUp { stage, times: child.failed_starts(), how });
        }
        child.give_up(self.supervision.retry);
        self.metrics.set_degraded(stage, true);
        tracing::error!(stage, how, "does not get up: the set goes on without it");
        Ok(())
    }

    /// Kills all processes of a stage, which are started again at once; false when there is none.
    pub fn restart(&mut self, stage: Stage) -> bool {
        let of_stage = self.children.iter_mut().filter(|child| child.stage == stage && child.is_running());
        of_stage.map(StageChild::replace).count() > 0
    }

    /// Stops all stages, drops what they know, lets `prepare` put something else into the directory (it gives the sequence of the
    /// first scan that follows), and starts them again.
    ///
    /// # Errors
    /// What `prepare` or the start could not do.
    pub fn begin_anew<E: From<SetError>>(
        &mut self,
        prepare: impl FnOnce(&RuntimeDir) -> Result<u64, E>,
    ) -> Result<(), E> {
        self.stop();
        self.runtime.remove_state().map_err(SetError::from)?;
        let prepared = prepare(&self.runtime);
        // Should it have failed, the stages begin with nothing.
        self.set.options.first_sequence = *prepared.as_ref().unwrap_or(&0);
        self.set.write(&self.runtime.configuration()).map_err(SetError::from)?;
        self.start_stages()?;
        prepared.map(|_| ())
    }

    /// Why something of the set waits in memory that should be in a file; `None` when nothing does.
    pub fn not_durable(&self) -> Option<&str> {
        self.not_durable.as_deref()
    }

    /// The sequence of the first scan of this session.
    pub fn first_sequence(&self) -> u64 {
        self.set.options.first_sequence
    }

    /// The configuration of its stages.
    pub fn configuration(&self) -> &Configuration {
        &self.set.configuration
    }

    /// How the set and each of its processes is.
    pub fn status(&self) -> SetStatus {
        let status_dir = self.runtime.status();
        let stages: Vec<_> = self.children.iter().map(|child| StageStatus::of(child, &status_dir)).collect();
        let degraded = stages.iter().any(|stage| stage.state == StageState::Degraded);
        SetStatus {
            robot: self.runtime.name().to_owned(),
            pid: std::process::id(),
            state: if degraded { SetState::Degraded } else { SetState::Running },
            paused: Pause::of(&status_dir).is_set(),
            uptime_s: self.started.elapsed().as_secs_f64(),
            saved: None,
            not_durable: self.not_durable.clone(),
            unattached: Unattached::read(&status_dir),
            localisation: LocalisationStatus::read(&status_dir).filter(|_| self.set.options.localizes),
            mode: self.mode_status(),
            flock: FlockStatus::read(&status_dir),
            lidars: LidarStatus::read(&status_dir),
            lidar_lines: read_lidar_lines(&status_dir),
            stages,
        }
    }

    /// Lets the set rest, or go on.
    ///
    /// # Errors
    /// When that cannot be stored: why.
    pub fn pause(&self, rests: bool) -> Result<(), String> {
        Pause::set(&self.runtime.status(), rests).map_err(|error| error.to_string())
    }

    /// What a process said when it ended by itself, else how it ended.
    fn reason(&self, stage: Stage, status: ExitStatus) -> String {
        let written =
            || std::fs::read_to_string(error_file(&self.runtime, stage)).ok().filter(|text| !text.is_empty());
        status.code().and_then(|_| written()).unwrap_or_else(|| describe(status))
    }

    fn ended(&self, stage: Stage, status: ExitStatus) -> SetError {
        let reason = std::fs::read_to_string(error_file(&self.runtime, stage)).ok();
        match (status.code(), reason) {
            (Some(EXIT_BAD_SOURCE), Some(reason)) => SetError::Source(reason),
            (_, reason) => {
                SetError::Ended { stage: stage.name(), how: reason.unwrap_or_else(|| describe(status)) }
            }
        }
    }

    fn clean(&mut self) {
        self.cleaned = Instant::now();
        let unfinished = self.runtime.remove_unfinished_objects();
        if unfinished > 0 {
            tracing::info!(unfinished, "shared memory that dead processes had only begun was removed");
        }
        let (cleaned, failed) = self.bus.clean_dead_nodes();
        if cleaned + failed > 0 {
            tracing::info!(cleaned, failed, "dead processes cleaned up");
        }
        let orphans = self.orphans.remove(&self.runtime);
        if orphans > 0 {
            tracing::info!(orphans, "what killed processes left of their nodes was removed");
        }
    }

    /// Asks the source to end: what was sent so far is the whole stream.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn end_stream(&self) -> Result<(), SetError> {
        self.orders.send(&Control { kind: ControlKind::EndWanted as u32, run: 0, value: 0 })?;
        self.source_notifier.notify();
        Ok(())
    }

    /// Stops all stages: SIGTERM, and SIGKILL for those that do not react.
    pub fn stop(&mut self) {
        self.dismiss_standbys();
        self.children.iter().for_each(|child| child.signal(Signal::TERM));
        let limit = if self.supervision.live { STOP_LIMIT_LIVE } else { STOP_LIMIT };
        let deadline = Instant::now() + limit;
        while self.children.iter().any(StageChild::is_running) {
            if Instant::now() > deadline {
                self.children.iter().for_each(|child| child.signal(Signal::KILL));
            }
            self.wait_for_deaths(Duration::from_millis(20));
            self.children.iter_mut().for_each(|child| {
                child.reap();
            });
        }
    }

    /// The set's directory.
    pub fn runtime(&self) -> &RuntimeDir {
        &self.runtime
    }

    /// Whether all state goes with the set, or stays for the next one of its name.
    pub fn wipe_at_end(&mut self, wipes: bool) {
        self.runtime.wipe_at_end(wipes);
    }

    /// Metrics of the supervisor itself about the set; clones share the numbers.
    pub fn metrics(&self) -> &SupervisorMetrics {
        &self.metrics
    }

    /// All stages: processes so far, of all replicas, and restarts.
    pub fn stages(&self) -> impl Iterator<Item = (Stage, Vec<u32>, u64)> {
        Stage::ALL.into_iter().map(|stage| {
            let replicas = || self.children.iter().filter(move |child| child.stage == stage);
            let pids = replicas().flat_map(|child| &child.pids).copied().collect();
            (stage, pids, replicas().map(StageChild::restarts).sum())
        })
    }
}

impl Drop for ProcessSet {
    fn drop(&mut self) {
        self.children.iter().for_each(|child| child.signal(Signal::KILL));
        while self.children.iter().any(StageChild::is_running) {
            self.wait_for_deaths(Duration::from_millis(20));
            self.children.iter_mut().for_each(|child| {
                child.reap();
            });
        }
    }
}

/// Removes the oldest reports of a stage's dead processes: thousands of restarts shall not fill the memory.
fn prune_reports(status_dir: &Path, stage: Stage) {
    let Ok(entries) = std::fs::read_dir(status_dir) else { return };
    let is_report = |name: &str| name.starts_with(stage.name()) && name.ends_with(".report");
    let reports = entries.flatten().filter(|entry| is_report(&entry.file_name().to_string_lossy()));
    let mut reports: Vec<_> =
        reports.filter_map(|entry| Some((entry.metadata().ok()?.modified().ok()?, entry.path()))).collect();
    reports.sort();
    for (_, path) in &reports[..reports.len().saturating_sub(REPORTS_MAX)] {
        // Should it stay, it is tried again with the next start.
        let _ = std::fs::remove_file(path);
    }
}

/// One process for each stage, and further replicas where they are configured.
fn children(set: &SetFile) -> Vec<StageChild> {
    let of_stage = |stage| {
        (0..set.configuration.replicas(stage) as u32).map(move |replica| StageChild::new(stage, replica))
    };
    Stage::ALL.into_iter().flat_map(of_stage).collect()
}

/// Steps that a stage yields to other processes: live, a pose is awaited, the map of it and a loop closure can be a little later. What
/// leads to a pose takes little of a processor, and takes it before others where the system allows that (`LimitNICE` of a service).
fn niceness(stage: Stage, mode: Mode) -> i32 {
    match (mode, stage) {
        (Mode::Exact, _) => 0,
        (Mode::Live, Stage::LidarIngest | Stage::CorrelationFilter | Stage::ScanMatcher) => -10,
        (Mode::Live, Stage::Mapper) => 5,
        (Mode::Live, Stage::DynamicCleaner) => 8,
        (Mode::Live, Stage::SyncManager) => 15,
    }
}

/// Where a stage writes why it could not go on.
pub fn error_file(runtime: &RuntimeDir, stage: Stage) -> PathBuf {
    runtime.status().join(format!("{}.error", stage.name()))
}

fn describe(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => "unknown".to_owned(),
    }
}
