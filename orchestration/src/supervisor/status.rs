//! The state of a set and of its processes: as JSON for programs and as text for people.

use super::child::StageChild;
use flockslam_lidar_ingest::process::LidarLineStatus;
use flockslam_results::{FlockStatus, LidarStatus, LocalisationStatus, Unattached};
use flockslam_telemetry::{Beat, monotonic_ns};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;

/// How a running set is: what `flockslam status --json` prints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SetStatus {
    /// Name of the set.
    pub robot: String,
    /// Process of the supervisor.
    pub pid: u32,
    /// Whether all stages work.
    pub state: SetState,
    /// Whether it is paused.
    pub paused: bool,
    /// Seconds since the start of the supervisor.
    pub uptime_s: f64,
    /// How the map is saved to disk, when it is.
    pub saved: Option<SaveStatus>,
    /// Why something of the set waits in memory that should be in a file.
    #[serde(default)]
    pub not_durable: Option<String>,
    /// What nothing connects with its map; `None` when all scans are in it.
    #[serde(default)]
    pub unattached: Option<Unattached>,
    /// Its belief about its pose in the known map, when it localizes.
    #[serde(default)]
    pub localisation: Option<LocalisationStatus>,
    /// What it does with its map.
    #[serde(default)]
    pub mode: ModeStatus,
    /// Status of its flock from its sync-manager, when it is part of one.
    #[serde(default)]
    pub flock: Option<FlockStatus>,
    /// Its lidars that have given scans, by number.
    #[serde(default)]
    pub lidars: Vec<LidarStatus>,
    /// Its lidars on lines of their own.
    #[serde(default)]
    pub lidar_lines: Vec<LidarLineStatus>,
    /// All processes, in the order of their start.
    pub stages: Vec<StageStatus>,
}

/// How a set is as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SetState {
    /// All stages work, or are being restarted.
    Running,
    /// A stage does not get up, and the set goes on without it.
    Degraded,
}

/// What a set does with its map.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModeStatus {
    /// `map` or `localize`.
    pub name: String,
    /// It is being changed.
    pub changing: bool,
    /// Why the last change was not possible.
    pub problem: Option<String>,
}

impl ModeStatus {
    /// How the last change of the mode came out; none while it is being changed.
    pub fn outcome(self) -> Option<Result<(), String>> {
        (!self.changing).then(|| self.problem.map_or(Ok(()), Err))
    }
}

/// How the map of a set is saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SaveStatus {
    /// Where.
    pub directory: String,
    /// Whether the last attempt succeeded.
    pub durable: bool,
    /// Seconds since the last success; `None` before the first.
    pub age_s: Option<f64>,
    /// Why the last attempt failed.
    pub problem: Option<String>,
}

/// How one process of a set is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageStatus {
    /// Which stage.
    pub stage: String,
    /// Which replica of it.
    pub replica: u32,
    /// The process, while there is one.
    pub pid: Option<u32>,
    /// What it does.
    pub state: StageState,
    /// How often it was started again.
    pub restarts: u64,
    /// How often it was replaced because it hung.
    pub hangs: u64,
    /// Scans that the present process has handled.
    pub handled: u64,
    /// Seconds since its last sign of life.
    pub silent_s: Option<f64>,
}

/// What a process of a set does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StageState {
    /// It recovers what its predecessor knew.
    Starting,
    /// It works.
    Running,
    /// It ended and waits for its restart.
    Down,
    /// It does not get up; it is tried again now and then.
    Degraded,
}

impl StageStatus {
    /// Of a child, as it is now.
    pub(super) fn of(child: &StageChild, status_dir: &Path) -> Self {
        let beat = child.beat(status_dir);
        let state = match (&beat, child.is_running()) {
            _ if child.is_given_up() => StageState::Degraded,
            (_, false) => StageState::Down,
            (Some(beat), true) if beat.ready => StageState::Running,
            _ => StageState::Starting,
        };
        let silent_ns = |beat: Beat| monotonic_ns().saturating_sub(beat.monotonic_ns);
        Self {
            stage: child.stage.name().to_owned(),
            replica: child.replica,
            pid: child.pids.last().copied().filter(|_| child.is_running()),
            state,
            restarts: child.restarts(),
            hangs: child.hangs,
            handled: beat.map_or(0, |beat| beat.handled),
            silent_s: beat.map(|beat| silent_ns(beat) as f64 * 1e-9),
        }
    }
}

impl StageState {
    fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Running => "running",
            Self::Down => "down",
            Self::Degraded => "degraded",
        }
    }
}

#[cfg(test)]
impl SetStatus {
    /// A set that runs, with these stages and nothing else to say.
    pub fn of_stages(stages: Vec<StageStatus>) -> Self {
        Self {
            robot: "r1".to_owned(),
            pid: 1,
            state: SetState::Running,
            paused: false,
            uptime_s: 1.0,
            saved: None,
            not_durable: None,
            unattached: None,
            localisation: None,
            mode: ModeStatus::default(),
            flock: None,
            lidars: Vec::new(),
            lidar_lines: Vec::new(),
            stages,
        }
    }
}

impl fmt::Display for SetStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = match (self.state, self.paused) {
            (SetState::Degraded, _) => "DEGRADED",
            (SetState::Running, true) => "PAUSED",
            (SetState::Running, false) => "running",
        };
        writeln!(f, "{}: {state}, supervisor {}, up {:.0} s", self.robot, self.pid, self.uptime_s)?;
        for stage in &self.stages {
            writeln!(
                f,
                "  {:<18} {:>2}  {:<9} pid {:<8} restarts {:<4} hangs {:<3} scans {}",
                stage.stage,
                stage.replica,
                stage.state.name(),
                stage.pid.map_or("-".to_owned(), |pid| pid.to_string()),
                stage.restarts,
                stage.hangs,
                stage.handled
            )?;
        }
        for status in &self.lidars {
            let (LidarStatus { lidar, scans, .. }, now_ns) = (status, monotonic_ns());
            let silent = if status.is_silent(now_ns) { "SILENT, " } else { "" };
            writeln!(
                f,
                "  lidar {lidar:<12} {silent}last scan {:.1} s ago, scans {scans}",
                status.age_s(now_ns)
            )?;
        }
        for line in &self.lidar_lines {
            writeln!(f, "  {line}")?;
        }
        if let Some(unattached) = &self.unattached {
            writeln!(f, "  {unattached}")?;
        }
        if self.mode.changing {
            writeln!(f, "  the mode is being changed: the map as it is now is worked out")?;
        }
        if let Some(problem) = &self.mode.problem {
            writeln!(f, "  the mode is not changed: {problem}")?;
        }
        if let Some(localisation) = &self.localisation {
            writeln!(f, "  {localisation}")?;
        }
        if let Some(flock) = &self.flock {
            write_flock(f, flock)?;
        }
        if let Some(problem) = &self.not_durable {
            writeln!(f, "  NOT DURABLE: {problem}")?;
        }
        match &self.saved {
            Some(SaveStatus { directory, durable: true, age_s: Some(age_s), .. }) => {
                writeln!(f, "  map saved in {directory} {age_s:.0} s ago")
            }
            Some(SaveStatus { directory, problem: Some(problem), .. }) => {
                writeln!(f, "  NOT DURABLE: {directory}: {problem}")
            }
            Some(SaveStatus { directory, .. }) => writeln!(f, "  map not yet saved in {directory}"),
            None if self.localisation.is_some() => Ok(()),
            None => writeln!(f, "  the map is not saved: give --map DIR"),
        }
    }
}

fn write_flock(f: &mut fmt::Formatter<'_>, flock: &FlockStatus) -> fmt::Result {
    let peers = flock.peers.len();
    write!(f, "  flock {}: {peers} connected, {} near, ", flock.flock, flock.near.len())?;
    let kilobytes = flock.records.1 as f64 * 1e-3;
    write!(f, "{} robots known by {} records ({kilobytes:.0} kB)", flock.robots.len(), flock.records.0)?;
    match (&flock.problem, flock.merged) {
        (Some(problem), _) => writeln!(f, "; THE NETWORK IS NOT OPEN: {problem}"),
        (None, true) => writeln!(f, "; in one map: {}", flock.members.join(", ")),
        (None, false) => writeln!(f, "; not in a common map"),
    }
}
