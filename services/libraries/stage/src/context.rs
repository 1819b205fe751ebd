//! What surrounds a stage's logic: bus, directories, mode, metrics, heartbeat and report.

use crate::report::ReportWriter;
use crate::{Clock, GridReader, StageError};
use flockslam_bus::{Bus, Capacity, RuntimeDir};
use flockslam_journal::is_durable;
use flockslam_messages::{DropReason, ScanView, Stage};
use flockslam_telemetry::{Heartbeat, LogLevels, MetricsEndpoint, StageMetrics};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// How joins are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Replay at full speed: every stage waits for exactly its inputs, no scan is lost, the result is the same to the bit.
    Exact,
    /// Live operation: no stage waits past a deadline, the newest data wins, every loss is counted.
    Live,
}

/// What a stage needs to know to start.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct StageOptions {
    /// How joins are made.
    pub mode: Mode,
    /// Credit window, scans.
    pub window: usize,
    /// Greatest number of replicas of a stage.
    pub replicas: usize,
    /// Greatest number of live tiles.
    pub live_tiles: usize,
    /// Sequence of the first scan of this session: what comes before belongs to a map that is continued.
    #[serde(default)]
    pub first_sequence: u64,
    /// The set localizes in the map that is in its results, and makes no map.
    #[serde(default)]
    pub localizes: bool,
}

impl StageOptions {
    /// The limits of the bus.
    pub fn capacity(&self) -> Capacity {
        Capacity { window: self.window, replicas: self.replicas, live_tiles: self.live_tiles }
    }
}

/// Set when the stage shall end.
#[derive(Clone, Default)]
pub struct StopFlag(Arc<AtomicBool>);

impl StopFlag {
    /// A flag that SIGTERM sets. SIGINT is left to the supervisor: a terminal sends it to all processes of the set.
    ///
    /// # Errors
    /// When the handlers cannot be installed.
    pub fn on_signals() -> Result<Self, StageError> {
        let flag = Self::default();
        let ignored = Arc::new(AtomicBool::new(false));
        for (signal, target) in
            [(signal_hook::consts::SIGTERM, &flag.0), (signal_hook::consts::SIGINT, &ignored)]
        {
            signal_hook::flag::register(signal, Arc::clone(target))
                .map_err(|e| StageError::Telemetry(format!("cannot handle signal {signal}: {e}")))?;
        }
        Ok(flag)
    }

    /// Asks for the end.
    pub fn stop(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether the end was requested.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// Everything around a stage's logic: bus, places, mode, telemetry.
pub struct StageContext {
    /// Which stage this is.
    pub stage: Stage,
    /// Which replica of it.
    pub replica: u32,
    /// The bus of the set.
    pub bus: Bus,
    /// How joins are made.
    pub mode: Mode,
    /// Sizes of the set.
    pub capacity: Capacity,
    /// Sequence of the first scan of this session: what comes before belongs to a map that is continued.
    pub first_sequence: u64,
    /// The set localizes in the map that is in its results, and makes no map.
    pub localizes: bool,
    /// Journal of scans and poses.
    pub journal_dir: PathBuf,
    /// Store of closed submaps.
    pub submap_dir: PathBuf,
    /// Conclusions of sync-manager.
    pub result_dir: PathBuf,
    /// Heartbeats, metrics and reports.
    pub status_dir: PathBuf,
    /// When to end.
    pub stop: StopFlag,
    /// The clock of latency and deadlines.
    pub clock: Clock,
    /// The stage's metrics.
    pub metrics: StageMetrics,
    /// What the stage reports about itself at the end.
    pub report: ReportWriter,
    runtime: PathBuf,
    heartbeat: Heartbeat,
    levels: LogLevels,
    /// Scans that were followed while another process was active.
    followed: u64,
    _endpoint: MetricsEndpoint,
}

impl StageContext {
    /// Joins the set in `runtime` as a process of its own.
    ///
    /// # Errors
    /// When the set does not exist, or telemetry cannot be set up.
    pub fn join(
        stage: Stage,
        replica: u32,
        runtime: &RuntimeDir,
        options: &StageOptions,
        stop: StopFlag,
    ) -> Result<Self, StageError> {
        let bus = Bus::join(runtime, &format!("{}-{replica}", stage.name()), options.capacity())?;
        Self::on_bus(stage, replica, bus, runtime, options, stop)
    }

    /// As [`StageContext::join`], on a bus that is already there (the in-memory twin, in a thread).
    ///
    /// # Errors
    /// When telemetry cannot be set up.
    pub fn on_bus(
        stage: Stage,
        replica: u32,
        bus: Bus,
        runtime: &RuntimeDir,
        options: &StageOptions,
        stop: StopFlag,
    ) -> Result<Self, StageError> {
        let status_dir = runtime.status();
        let name = format!("{}-{replica}", stage.name());
        let telemetry = |error: &dyn std::fmt::Display| StageError::Telemetry(error.to_string());
        let metrics = StageMetrics::new(stage.name(), replica, &DropReason::ALL.map(DropReason::name));
        let rendered = metrics.clone();
        let endpoint =
            MetricsEndpoint::on_unix_socket(&metrics_socket(&status_dir, &name), move || rendered.render());
        Ok(Self {
            stage,
            replica,
            bus,
            mode: options.mode,
            capacity: options.capacity(),
            first_sequence: options.first_sequence,
            localizes: options.localizes,
            runtime: runtime.path().to_owned(),
            journal_dir: runtime.journal(),
            submap_dir: runtime.submaps(),
            result_dir: runtime.results(),
            stop,
            clock: Clock::System,
            metrics,
            report: ReportWriter::new(&status_dir, &name),
            followed: 0,
            levels: LogLevels::of(&status_dir, stage.name()),
            heartbeat: Heartbeat::open(&heartbeat_file(&status_dir, &name)).map_err(|e| telemetry(&e))?,
            _endpoint: endpoint.map_err(|e| telemetry(&e))?,
            status_dir,
        })
    }

    /// Gives a thread of the stage what it needs to join the bus: ports stay within their thread.
    pub fn joiner(&self) -> impl FnOnce() -> Option<Bus> + Send + 'static {
        let (runtime, capacity) = (self.runtime.clone(), self.capacity);
        let name = format!("{}-{}-thread", self.stage.name(), self.replica);
        move || Bus::join(&RuntimeDir::open(&runtime).ok()?, &name, capacity).ok()
    }

    /// The directory of the set.
    pub fn set_dir(&self) -> &Path {
        &self.runtime
    }

    /// The clock of latency and deadlines, nanoseconds; comparable between the processes of a set.
    pub fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// Tests only: reports the address of a scan's numbers in this process.
    pub fn probe_scan(&mut self, _scan: ScanView<'_>) {
        #[cfg(debug_assertions)]
        {
            self.report.report.scan_address = _scan.ranges().as_ptr() as u64;
        }
    }

    /// Tests only: reports the address of a tile in this process.
    pub fn probe_tile(&mut self, _grid: &GridReader) {
        #[cfg(debug_assertions)]
        if let Some((_, tile)) = _grid.grid().tiles().next() {
            self.report.report.tile_address = std::ptr::from_ref(tile) as u64;
        }
    }

    /// Records that a scan was handled: `started_ns` is when the stage began with it, `captured_ns` when it was taken.
    pub fn handled(&mut self, sequence: u64, started_ns: u64, captured_ns: u64) {
        let now_ns = self.now_ns();
        let (latency_ns, since_capture_ns) =
            (now_ns.saturating_sub(started_ns), now_ns.saturating_sub(captured_ns));
        self.metrics.handled(sequence, latency_ns, since_capture_ns);
        self.metrics.captured(captured_ns);
        self.report.handled(latency_ns, since_capture_ns);
        if self.report.report.handled == 1 {
            self.alive();
        }
    }

    /// Counts a drop.
    pub fn dropped(&mut self, reason: &'static str) {
        self.metrics.dropped(reason);
        self.report.dropped(reason);
    }

    /// A process that is on standby has followed the active one for so many more scans.
    pub fn followed(&mut self, scans: u64) {
        self.followed += scans;
        self.alive();
    }

    /// A scan has passed that leaves nothing to do for this stage: the process works all the same.
    pub fn passed_over(&mut self) {
        if self.heartbeat.set_works() {
            self.alive();
        }
    }

    /// The stage has recovered the state of its predecessor, and works from now on.
    pub fn ready(&mut self) {
        self.heartbeat.set_ready();
        self.alive();
    }

    /// A sign of life; cheap when called often.
    pub fn alive(&mut self) {
        let now_ns = self.now_ns();
        self.metrics.alive(now_ns);
        self.levels.look(now_ns);
        let durable = is_durable();
        match (self.heartbeat.set_durable(durable), durable) {
            (true, false) => tracing::info!("what cannot be written waits in memory"),
            (true, true) => tracing::info!("all that waited is written"),
            _ => {}
        }
        if let Err(error) = self.heartbeat.beat(now_ns, self.metrics.handled_count() + self.followed) {
            tracing::warn!(%error, "no heartbeat");
        }
    }
}

/// Where a stage's metrics are served.
pub fn metrics_socket(status_dir: &Path, name: &str) -> PathBuf {
    status_dir.join(format!("{name}.metrics"))
}

/// Where a stage's heartbeat is.
pub fn heartbeat_file(status_dir: &Path, name: &str) -> PathBuf {
    status_dir.join(format!("{name}.heartbeat"))
}
