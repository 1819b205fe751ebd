//! `report.json`: the figures of one run, as plain data.

use super::{CalibrationRow, OutputError, put};
use flockslam_results::DetachedRow;
use flockslam_telemetry::LatencyQuantiles;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// `report.json`: what a run read, did and cost.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of the program.
    pub version: String,
    /// Where the scans came from: the log's path, `standard input` or `simulated building`.
    pub source: String,
    /// The whole configuration that was in force.
    pub configuration: serde_json::Value,
    /// Scans that the source gave. Each has a line in both trajectories, but for those counted as `lost`.
    pub scans: u64,
    /// Scans that were processed: all that were not dropped.
    pub kept: u64,
    /// Scans that got a predicted pose only: reason → count. Live, `lost` counts those that never reached the matcher.
    pub dropped: BTreeMap<String, u64>,
    /// The same as shares of all scans.
    pub dropped_share: BTreeMap<String, f64>,
    /// Scans that the filter let pass: reason → count.
    pub kept_by_reason: BTreeMap<String, u64>,
    /// Scans that the filter would have dropped and the matcher processed nevertheless.
    pub overridden: u64,
    /// Lines or scans of the source that could not be used: reason → count.
    pub rejected: BTreeMap<String, u64>,
    /// Wall-clock time of the run, seconds.
    pub wall_s: f64,
    /// `scans / wall_s`.
    pub scans_per_s: f64,
    /// From the capture of a scan to its published pose.
    pub scan_to_pose_us: LatencyMicroseconds,
    /// Each stage by name.
    pub stages: BTreeMap<String, StageReport>,
    /// The supervisor's own share; its latency does not exist.
    pub supervisor: ProcessUse,
    /// Processor time of the whole set, supervisor included, from the start of each process to its end, seconds.
    pub cpu_s: f64,
    /// Peak of the memory of the whole set, each page counted once, bytes: the private peaks of all processes, as if they coincided,
    /// `shared_memory_bytes`, and `file_bytes`; or what is left while the outputs are written, should that be more.
    pub memory_bytes: u64,
    /// Peak of the set's shared-memory objects and files on tmpfs, bytes.
    pub shared_memory_bytes: u64,
    /// Pages of the executable and its libraries, which all processes share: the most that one of them had mapped, bytes.
    pub file_bytes: u64,
    /// Hash of the fused map, hexadecimal: equal for equal maps.
    pub map_hash: String,
    /// Submaps that were closed.
    pub submaps: u64,
    /// Of those, submaps that left the map again, since newer ones know all that they knew.
    pub submaps_retired: u64,
    /// Bytes of all stored submaps.
    pub submap_bytes: u64,
    /// The same by the area that each of them knows, bytes/m².
    pub submap_bytes_per_m2: f64,
    /// Trajectories: more than one when the robot was lost and mapped anew.
    pub trajectories: u64,
    /// Scans of trajectories that nothing connects with the map: their poses are guesses, and the map is without them.
    pub detached_scans: u64,
    /// These trajectories, the longest first, with the subdirectory of their own map.
    pub detached: Vec<DetachedRow>,
    /// What the set did at its end: `map` or `localize`.
    #[serde(default)]
    pub mode: String,
    /// Scans that the set only localized with before it made the map further: they are no part of the map.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub scans_apart: u64,
    /// What localisation did, when the set localized in a known map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub localisation: Option<flockslam_results::LocalisationSummary>,
    /// Mountings and clock offsets of lidars, by the motions of scans and odometry; no row where the drive has no information about it.
    pub calibration: Vec<CalibrationRow>,
    /// Loop closures.
    pub loop_closures: LoopClosures,
    /// Area that is known to be free or occupied, m².
    pub map_area_m2: f64,
    /// Length of the final trajectory, metres.
    pub trajectory_length_m: f64,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// A stage's share of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// Every process that was this stage, in the order of their starts.
    pub pids: Vec<u32>,
    /// Restarts after a death or a hang.
    pub restarts: u64,
    /// Processor time of all of them, user and system, seconds.
    pub cpu_s: f64,
    /// Largest resident memory of one of them, bytes. It includes what is shared with others.
    pub peak_rss_bytes: u64,
    /// Largest private memory of one of them, bytes: heap, stacks, changed pages of files; no shared memory.
    pub peak_private_bytes: u64,
    /// Time in the stage's logic per scan.
    pub latency_us: LatencyMicroseconds,
}

/// What a process that is not a stage used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProcessUse {
    /// Processor time, user and system, seconds.
    pub cpu_s: f64,
    /// Largest resident memory, bytes.
    pub peak_rss_bytes: u64,
    /// Largest private memory while the stages ran, bytes.
    pub peak_private_bytes: u64,
    /// Largest private memory while the outputs were written, the stages having ended, bytes.
    pub outputs_private_bytes: u64,
}

/// A distribution of durations, microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LatencyMicroseconds {
    /// Median.
    pub p50: f64,
    /// 99 of 100 are at most this.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

/// What became of the loop closures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoopClosures {
    /// Matches of a scan against a submap that were tried.
    pub tried: u64,
    /// Matches that became a constraint.
    pub accepted: u64,
    /// Constraints that the solution switched off again.
    pub revoked: u64,
}

impl From<LatencyQuantiles> for LatencyMicroseconds {
    fn from(of: LatencyQuantiles) -> Self {
        let us = |ns: u64| ns as f64 * 1e-3;
        Self { p50: us(of.p50_ns), p99: us(of.p99_ns), max: us(of.max_ns) }
    }
}

/// Writes the report to `path` as indented JSON.
///
/// # Errors
/// When the disk refuses.
pub fn write_report(path: &Path, report: &Report) -> Result<(), OutputError> {
    let mut text = serde_json::to_string_pretty(report)?;
    text.push('\n');
    put(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_is_read_back_as_it_was_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("report.json");
        let quantiles = LatencyQuantiles { count: 2, p50_ns: 1500, p99_ns: 2000, max_ns: 2500 };
        let stage =
            StageReport { pids: vec![1, 2], restarts: 1, latency_us: quantiles.into(), ..Default::default() };
        let report = Report {
            version: "0.1.0".to_owned(),
            configuration: serde_json::json!({"matcher": {"levels": 3}}),
            dropped: BTreeMap::from([("correlated".to_owned(), 4)]),
            stages: BTreeMap::from([("mapper".to_owned(), stage)]),
            ..Report::default()
        };
        write_report(&path, &report).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(serde_json::from_str::<Report>(&text).unwrap(), report);
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value["stages"]["mapper"]["latency_us"]["p50"], 1.5);
        assert_eq!(value["dropped"]["correlated"], 4);
    }
}
