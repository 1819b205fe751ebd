use super::SetFile;
use super::child::StageChild;
use flockslam_bus::{BellRinger, Bus, BusError, Publisher, RuntimeDir, RuntimeError, Subscriber};
use flockslam_messages::{Control, ControlKind, Progress, Stage};
use flockslam_stage::{Mode, StageError, heartbeat_file};
use flockslam_telemetry::{SupervisorMetrics, read_heartbeat};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::Signal;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::ExitStatus;
use std::time::{Duration, Instant};

/// Exit code of a stage whose source is not usable: a mistake of the user's.
pub const EXIT_BAD_SOURCE: i32 = 2;
const READY_LIMIT: Duration = Duration::from_secs(20);
const STOP_LIMIT: Duration = Duration::from_secs(2);
const CLEAN_PERIOD: Duration = Duration::from_secs(1);

/// Why a process set failed.
#[derive(Debug, thiserror::Error)]
pub enum SetError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The runtime directory failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// A file of the set failed.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// A process could not be started or watched.
    #[error("cannot start {stage}: {source}")]
    Start {
        /// Which stage.
        stage: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// A stage did not get ready.
    #[error("{0} was not ready within {limit} s", limit = READY_LIMIT.as_secs())]
    NotReady(&'static str),
    /// The source of scans is not usable.
    #[error("{0}")]
    Source(String),
    /// A stage ended in exact replay, which has no restarts.
    #[error("{stage} ended during an exact replay ({how}): run it again, or replay live with --rate")]
    Ended {
        /// Which stage.
        stage: &'static str,
        /// Its exit status.
        how: String,
    },
    /// A stage keeps dying.
    #[error("{stage} died {times} times in a row soon after its start ({how})")]
    GivenUp {
        /// Which stage.
        stage: &'static str,
        /// How often it was started.
        times: usize,
        /// Its last exit status.
        how: String,
    },
}

/// What happened in a running set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetEvent {
    /// Nothing new.
    Quiet,
    /// The matcher has finished with this many scans.
    Progress(u64),
    /// The final layout and map are stored.
    Finished,
}

/// The processes of one robot, their shared memory and their state outside of them.
pub struct ProcessSet {
    children: Vec<StageChild>,
    progress: Subscriber<Progress>,
    control: Subscriber<Control>,
    metrics: SupervisorMetrics,
    orders: Publisher<Control>,
    source_bell: BellRinger,
    set: SetFile,
    executable: PathBuf,
    cleaned: Instant,
    // The bus goes before the directory that it lies in.
    bus: Bus,
    runtime: RuntimeDir,
}

impl ProcessSet {
    /// Creates shared memory and starts all stages: consumers first, the source when everybody listens.
    ///
    /// # Errors
    /// When a set of this name runs, or a stage cannot be started.
    pub fn start(name: &str, set: SetFile) -> Result<Self, SetError> {
        let executable =
            std::env::current_exe().map_err(|source| SetError::Start { stage: "flockslam", source })?;
        let runtime = RuntimeDir::create_spilling(name, set.configuration.set.spill_dir.as_deref())?;
        let bus = Bus::host(&runtime, set.options.capacity())?;
        set.write(&runtime.configuration())?;
        let mut started = Self {
            children: children(&set),
            progress: bus.subscriber()?,
            control: bus.subscriber()?,
            metrics: SupervisorMetrics::new(&Stage::ALL.map(Stage::name)),
            orders: bus.publisher()?,
            source_bell: bus.ringer(Stage::LidarIngest.name())?,
            executable,
            cleaned: Instant::now(),
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
        let mode = self.set.options.mode;
        let child = &mut self.children[at];
        let reads_stdin = child.stage == Stage::LidarIngest;
        let stage = child.stage.name();
        child
            .start(&self.executable, self.runtime.path(), reads_stdin, niceness(child.stage, mode))
            .map_err(|source| SetError::Start { stage, source })
    }

    fn wait_until_ready(&mut self, children: &[usize]) -> Result<(), SetError> {
        let deadline = Instant::now() + READY_LIMIT;
        for at in children {
            let StageChild { stage, replica, .. } = self.children[*at];
            let heartbeat = heartbeat_file(&self.runtime.status(), &format!("{}-{replica}", stage.name()));
            while !matches!(read_heartbeat(&heartbeat), Ok(Some(_))) {
                if let Some(status) = self.children[*at].reap() {
                    return Err(self.ended(stage, status));
                }
                if Instant::now() > deadline {
                    return Err(SetError::NotReady(stage.name()));
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        Ok(())
    }

    /// Waits up to `limit` for something to happen; restarts what has died.
    ///
    /// # Errors
    /// When the set cannot go on.
    pub fn watch(&mut self, limit: Duration) -> Result<SetEvent, SetError> {
        self.wait_for_deaths(limit);
        self.handle_deaths()?;
        if self.cleaned.elapsed() > CLEAN_PERIOD {
            self.clean();
        }
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
                if bad_source || self.set.options.mode == Mode::Exact {
                    return Err(self.ended(stage, status));
                }
                tracing::warn!(stage = stage.name(), how = describe(status), "restarting");
                if !self.children[at].plan_restart() {
                    let times = self.children[at].pids.len();
                    return Err(SetError::GivenUp { stage: stage.name(), times, how: describe(status) });
                }
            }
            if self.children[at].is_due() {
                self.spawn(at)?;
                self.metrics.restarted(self.children[at].stage.name());
            }
        }
        Ok(())
    }

    fn ended(&self, stage: Stage, status: ExitStatus) -> SetError {
        let told = std::fs::read_to_string(error_file(&self.runtime, stage)).ok();
        match (status.code(), told) {
            (Some(EXIT_BAD_SOURCE), Some(reason)) => SetError::Source(reason),
            (_, told) => {
                SetError::Ended { stage: stage.name(), how: told.unwrap_or_else(|| describe(status)) }
            }
        }
    }

    fn clean(&mut self) {
        self.cleaned = Instant::now();
        let (cleaned, failed) = self.bus.clean_dead_nodes();
        if cleaned + failed > 0 {
            tracing::info!(cleaned, failed, "dead processes cleaned up");
        }
    }

    /// Asks the source to end: what was sent so far is the whole stream.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn end_stream(&self) -> Result<(), SetError> {
        self.orders.send(&Control { kind: ControlKind::EndWanted as u32, epoch: 0, value: 0 })?;
        self.source_bell.ring();
        Ok(())
    }

    /// Stops all stages: SIGTERM, and SIGKILL for who does not listen.
    pub fn stop(&mut self) {
        self.children.iter().for_each(|child| child.signal(Signal::TERM));
        let deadline = Instant::now() + STOP_LIMIT;
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

    /// What the supervisor itself tells about the set; clones share the numbers.
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

/// One process for each stage, and further replicas where they are asked for.
fn children(set: &SetFile) -> Vec<StageChild> {
    let replicas = |stage| match stage {
        Stage::CorrelationFilter => set.configuration.correlation_filter.replicas as u32,
        _ => 1,
    };
    let of_stage = |stage| (0..replicas(stage)).map(move |replica| StageChild::new(stage, replica));
    Stage::ALL.into_iter().flat_map(of_stage).collect()
}

/// Steps that a stage yields to the others of its set: live, a pose is awaited, the map of it and a loop closure can be a
/// little later.
fn niceness(stage: Stage, mode: Mode) -> i32 {
    match (mode, stage) {
        (Mode::Exact, _) => 0,
        (Mode::Live, Stage::LidarIngest | Stage::CorrelationFilter | Stage::ScanMatcher) => 0,
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
