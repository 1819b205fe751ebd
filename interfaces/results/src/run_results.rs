//! What sync-manager leaves at the end of a run, as files in the set's directory.

use crate::{LocalisationSummary, ResultsError};
use flockslam_geometry::Pose;
use flockslam_journal::{Durability, replace_file, replace_file_by};
use flockslam_messages::{DropReason, PoseEstimate, PoseFlags};
use std::fs;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A pose at a sensor stamp: a row of a trajectory.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct StampedPose {
    /// Sensor stamp, nanoseconds.
    pub stamp_ns: i64,
    /// The pose.
    pub pose: Pose,
}

/// Final trajectory: `map_from_base` of every scan, in the order of the scans.
pub const FINAL_TRAJECTORY: &str = "final.poses";
/// Trajectory as it was published at the time.
pub const ONLINE_TRAJECTORY: &str = "online.poses";
/// Exact trajectory of a simulated robot.
pub const TRUE_TRAJECTORY: &str = "truth.poses";
/// What happened, as JSON.
pub const SUMMARY: &str = "summary.json";

/// Where submaps lie and which loops are closed, as of the last closed submap, as JSON.
const LIVE_POSES: &str = "live_poses.json";

/// Results of sync-manager for the whole run.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Summary {
    /// Poses published.
    pub scans: u64,
    /// Of those, matched to the grid.
    pub matched: u64,
    /// Scans whose evidence is in the map.
    pub inserted: u64,
    /// Scans that were not processed, by reason.
    pub dropped: std::collections::BTreeMap<String, u64>,
    /// Scans that the filter would have dropped and the matcher processed nevertheless.
    #[serde(default)]
    pub overridden: u64,
    /// Scans that needed a wide search.
    pub rescued: u64,
    /// Submaps.
    pub submaps: u64,
    /// Of those, submaps whose evidence is no longer in the map: newer ones know all that they knew.
    #[serde(default)]
    pub submaps_retired: u64,
    /// Bytes of all stored submaps.
    #[serde(default)]
    pub submap_bytes: u64,
    /// Area that the stored submaps know, each counted for itself, m².
    #[serde(default)]
    pub submap_area_m2: f64,
    /// Trajectories: more than one when the robot was lost and mapped anew.
    #[serde(default)]
    pub trajectories: u64,
    /// Scans of trajectories that nothing connects with the map.
    #[serde(default)]
    pub detached_scans: u64,
    /// These trajectories, the longest first.
    #[serde(default)]
    pub detached: Vec<DetachedRow>,
    /// What localisation did, when the set localized in a known map.
    #[serde(default)]
    pub localisation: Option<LocalisationSummary>,
    /// The set localized at its end, otherwise it made a map.
    #[serde(default)]
    pub localizes: bool,
    /// Scans that the set has localized with and that are no part of the map, in a run that has made one.
    #[serde(default)]
    pub scans_apart: u64,
    /// Searches for loop closures.
    pub closures_tried: u64,
    /// Closures that passed all checks.
    pub closures_accepted: u64,
    /// Of those, closures that do not act in the final solution.
    pub closures_revoked: u64,
}

/// Trajectories that nothing connects with the map.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DetachedRow {
    /// Number of the first of them, from 0.
    pub trajectory: u32,
    /// Their scans.
    pub scans: u64,
    /// Way driven, metres.
    pub travel_m: f64,
    /// Stamp of the first scan, seconds since the first scan of the run.
    pub from_s: f64,
    /// Stamp of the last scan, seconds since the first scan of the run.
    pub to_s: f64,
    /// Subdirectory with their own map and trajectory, if there is one.
    pub directory: Option<String>,
}

impl Summary {
    /// Counts a published pose.
    pub fn count(&mut self, pose: &PoseEstimate) {
        self.scans += 1;
        for (flag, counter) in [
            (PoseFlags::MATCHED, &mut self.matched),
            (PoseFlags::INSERT, &mut self.inserted),
            (PoseFlags::OVERRIDDEN, &mut self.overridden),
            (PoseFlags::RESCUED, &mut self.rescued),
        ] {
            *counter += u64::from(pose.has(flag));
        }
        let dropped = DropReason::from_number(pose.drop_reason);
        if let Some(reason) = dropped.filter(|_| !pose.has(PoseFlags::OVERRIDDEN)) {
            match self.dropped.get_mut(reason.name()) {
                Some(count) => *count += 1,
                // The name is made once for each reason, not for each scan.
                None => drop(self.dropped.insert(reason.name().to_owned(), 1)),
            }
        }
    }
}

/// Where a stored submap is in the final map.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SubmapRow {
    /// Number of the submap.
    pub number: u32,
    /// Takes the coordinates of its cells to the map: metres, metres, radians.
    pub map_from_odom: [f64; 3],
}

/// Results of sync-manager so far, for observers of a running set.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LivePoses {
    /// Submaps that are part of the map.
    pub submaps: Vec<SubmapRow>,
    /// Closed loops: x and y of both ends in the map, metres; then 1 when the loop acts, 0 when it is revoked.
    pub closures: Vec<[f64; 5]>,
    /// Searches for loops.
    pub searches: u64,
    /// Loops found, those whose place is frozen and that are not listed any more among them.
    pub accepted: u64,
}

/// Writes a trajectory into a set's results, one pose after the other: they need not lie in memory together.
///
/// # Errors
/// When a pose cannot be read or the disk refuses.
pub fn write_trajectory(
    directory: &Path,
    name: &str,
    rows: impl IntoIterator<Item = io::Result<StampedPose>>,
) -> Result<(), ResultsError> {
    let write = |file: &mut fs::File| {
        let mut file = BufWriter::new(file);
        rows.into_iter().try_for_each(|row| file.write_all(row?.as_bytes()))?;
        file.flush()
    };
    Ok(replace_file_by(&directory.join(name), write, Durability::Process)?)
}

/// Reads a trajectory from a set's results.
///
/// # Errors
/// When there is none, or it is cut off.
pub fn read_trajectory(directory: &Path, name: &str) -> Result<Vec<StampedPose>, ResultsError> {
    let path = directory.join(name);
    let wrong = |e| ResultsError::file(&path, e);
    let file = fs::File::open(&path).map_err(wrong)?;
    let bytes = file.metadata().map_err(wrong)?.len() as usize;
    if !bytes.is_multiple_of(size_of::<StampedPose>()) {
        return Err(ResultsError::file(&path, "cut off in the middle of a pose"));
    }
    let mut file = BufReader::new(file);
    let mut rows = Vec::with_capacity(bytes / size_of::<StampedPose>());
    let mut row = [0; size_of::<StampedPose>()];
    for _ in 0..bytes / size_of::<StampedPose>() {
        file.read_exact(&mut row).map_err(wrong)?;
        rows.extend(StampedPose::read_from_bytes(&row));
    }
    Ok(rows)
}

/// Writes the summary into a set's results.
///
/// # Errors
/// When the disk refuses.
pub fn write_summary(directory: &Path, summary: &Summary) -> Result<(), ResultsError> {
    let path = directory.join(SUMMARY);
    let json = serde_json::to_vec_pretty(summary).map_err(|e| ResultsError::file(&path, e))?;
    Ok(replace_file(&path, &json, Durability::Process)?)
}

/// The file of what was concluded so far.
pub fn live_poses_file(directory: &Path) -> PathBuf {
    directory.join(LIVE_POSES)
}

/// Writes what was concluded so far.
///
/// # Errors
/// When the disk refuses.
pub fn write_live_poses(directory: &Path, poses: &LivePoses) -> Result<(), ResultsError> {
    let path = live_poses_file(directory);
    let json = serde_json::to_vec(poses).map_err(|e| ResultsError::file(&path, e))?;
    Ok(replace_file(&path, &json, Durability::Process)?)
}

/// Reads what was concluded so far.
///
/// # Errors
/// When nothing was.
pub fn read_live_poses(directory: &Path) -> Result<LivePoses, ResultsError> {
    let path = live_poses_file(directory);
    let json = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
    serde_json::from_slice(&json).map_err(|e| ResultsError::file(&path, e))
}

/// Reads the summary from a set's results.
///
/// # Errors
/// When there is none.
pub fn read_summary(directory: &Path) -> Result<Summary, ResultsError> {
    let path = directory.join(SUMMARY);
    let json = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
    serde_json::from_slice(&json).map_err(|e| ResultsError::file(&path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_trajectories_are_read_and_torn_ones_are_not() {
        let directory = tempfile::tempdir().unwrap();
        let rows: Vec<_> =
            (0..3).map(|i| StampedPose { stamp_ns: -i, pose: Pose::new(i as f64, 0.5, 0.1) }).collect();
        write_trajectory(directory.path(), FINAL_TRAJECTORY, rows.iter().copied().map(Ok)).unwrap();
        assert_eq!(read_trajectory(directory.path(), FINAL_TRAJECTORY).unwrap(), rows);
        let path = directory.path().join(FINAL_TRAJECTORY);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        assert!(read_trajectory(directory.path(), FINAL_TRAJECTORY).is_err());
    }
}
