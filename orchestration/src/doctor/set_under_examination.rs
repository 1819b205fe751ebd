//! A set as `flockslam doctor` sees it: readings alone.

use crate::supervisor::SetStatus;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Readings of a set: what its description says, and how it runs.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SetReading {
    /// Its name.
    pub robot: String,
    /// Its description, where one was given.
    pub description: Option<PathBuf>,
    /// Why the description or its configuration is refused.
    pub refused: Option<String>,
    /// Shared memory that it takes when it starts, bytes.
    pub needs_bytes: Option<u64>,
    /// Ports of its lidars.
    pub lidar_ports: Vec<PathBuf>,
    /// Of those, ports that are not there.
    pub lacking_ports: Vec<PathBuf>,
    /// Lidars that it has on lines of their own.
    pub lidars: usize,
    /// Of those, lidars whose mounting is configured.
    pub mounted: usize,
    /// It is a node of a ROS graph over DDS.
    pub uses_dds: bool,
    /// Where its map is kept.
    pub map: Option<PathBuf>,
    /// Where journal and submaps shall be.
    pub spill: Option<PathBuf>,
    /// The map that it localizes in is not there.
    pub lacks_known_map: Option<PathBuf>,
    /// It is in a flock.
    pub flock: bool,
    /// Endpoints that its flock connects to, and why one does not answer.
    pub flock_endpoints: Vec<(String, Option<String>)>,
    /// The address of its page that another program has, while the set does not run.
    pub page_taken: Option<String>,
    /// How it runs.
    pub running: Option<RunningReading>,
}

/// How a set runs.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RunningReading {
    /// Version of the executable that has started it.
    pub version: Option<String>,
    /// What its supervisor says; `None` when it does not answer.
    pub status: Option<SetStatus>,
    /// Scans a second of each lidar.
    pub lidar_rates: Vec<LidarRate>,
    /// Scans a second that the scan-matcher handles.
    pub handled_hz: f64,
    /// Lidars that are silent.
    pub silent: Vec<String>,
    /// Scans dropped since the start, by reason.
    pub dropped: BTreeMap<String, f64>,
    /// What was logged as a warning or an error in the last minutes.
    pub problems: Vec<LogProblem>,
}

/// How often scans of a lidar come.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LidarRate {
    /// The lidar.
    pub lidar: String,
    /// Scans a second that reach the set.
    pub scans_hz: f64,
    /// Turns a second, as the lidar says itself.
    pub turns_hz: Option<f64>,
}

/// Lines of the log that say the same.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LogProblem {
    /// Which process has said it.
    pub stage: String,
    /// What it has said.
    pub message: String,
    /// How often.
    pub times: u64,
}
