//! What sync-manager leaves at the end of a run, as files in the set's directory.

use crate::StageError;
use flockslam_evidence::Cell;
use flockslam_geometry::{Point, Pose};
use flockslam_journal::{Durability, replace_file};
use std::fs;
use std::path::Path;
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
/// The fused map.
pub const FUSED_MAP: &str = "fused.map";
/// What happened, as JSON.
pub const SUMMARY: &str = "summary.json";

/// What sync-manager tells about the whole run.
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
    /// Scans that needed a wide search.
    pub rescued: u64,
    /// Submaps.
    pub submaps: u64,
    /// Searches for loop closures.
    pub closures_tried: u64,
    /// Closures that passed all checks.
    pub closures_accepted: u64,
    /// Of those, closures that do not act in the final layout.
    pub closures_revoked: u64,
}

/// A fused map: evidence on a rectangle of cells.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredMap {
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Lower left corner in the map frame.
    pub origin: Point,
    /// Evidence, row by row, the lowest y first.
    pub cells: Vec<Cell>,
}

#[repr(C)]
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
struct MapHead {
    width: u64,
    height: u64,
    cell_size_m: f64,
    origin: Point,
}

/// Writes a trajectory into a set's results.
///
/// # Errors
/// When the disk refuses.
pub fn write_trajectory(directory: &Path, name: &str, rows: &[StampedPose]) -> Result<(), StageError> {
    Ok(replace_file(&directory.join(name), rows.as_bytes(), Durability::Process)?)
}

/// Reads a trajectory from a set's results.
///
/// # Errors
/// When there is none, or it is cut off.
pub fn read_trajectory(directory: &Path, name: &str) -> Result<Vec<StampedPose>, StageError> {
    let path = directory.join(name);
    let bytes = fs::read(&path).map_err(|e| StageError::file(&path, e))?;
    let rows = bytes.chunks(size_of::<StampedPose>()).map(StampedPose::read_from_bytes);
    rows.collect::<Result<_, _>>().map_err(|_| StageError::file(&path, "cut off in the middle of a pose"))
}

/// Writes the fused map into a set's results.
///
/// # Errors
/// When the disk refuses.
pub fn write_map(directory: &Path, map: &StoredMap) -> Result<(), StageError> {
    assert_eq!(map.cells.len(), map.width * map.height);
    let head = MapHead {
        width: map.width as u64,
        height: map.height as u64,
        cell_size_m: map.cell_size_m,
        origin: map.origin,
    };
    let bytes = [head.as_bytes(), map.cells.as_bytes()].concat();
    Ok(replace_file(&directory.join(FUSED_MAP), &bytes, Durability::Process)?)
}

/// Reads the fused map from a set's results.
///
/// # Errors
/// When there is none, or it is not whole.
pub fn read_map(directory: &Path) -> Result<StoredMap, StageError> {
    let path = directory.join(FUSED_MAP);
    let bytes = fs::read(&path).map_err(|e| StageError::file(&path, e))?;
    let broken = || StageError::file(&path, "is not a whole map");
    let (head, rest) = MapHead::read_from_prefix(&bytes).map_err(|_| broken())?;
    let count = head.width.checked_mul(head.height).ok_or_else(broken)?;
    if Some(rest.len() as u64) != count.checked_mul(size_of::<Cell>() as u64) {
        return Err(broken());
    }
    let cells = rest.chunks_exact(size_of::<Cell>()).map(Cell::read_from_bytes).collect::<Result<_, _>>();
    Ok(StoredMap {
        width: head.width as usize,
        height: head.height as usize,
        cell_size_m: head.cell_size_m,
        origin: head.origin,
        cells: cells.map_err(|_| broken())?,
    })
}

/// Writes the summary into a set's results.
///
/// # Errors
/// When the disk refuses.
pub fn write_summary(directory: &Path, summary: &Summary) -> Result<(), StageError> {
    let path = directory.join(SUMMARY);
    let json = serde_json::to_vec_pretty(summary).map_err(|e| StageError::file(&path, e))?;
    Ok(replace_file(&path, &json, Durability::Process)?)
}

/// Reads the summary from a set's results.
///
/// # Errors
/// When there is none.
pub fn read_summary(directory: &Path) -> Result<Summary, StageError> {
    let path = directory.join(SUMMARY);
    let json = fs::read(&path).map_err(|e| StageError::file(&path, e))?;
    serde_json::from_slice(&json).map_err(|e| StageError::file(&path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trajectories_and_maps_come_back_and_torn_ones_do_not() {
        let directory = tempfile::tempdir().unwrap();
        let rows: Vec<_> =
            (0..3).map(|i| StampedPose { stamp_ns: -i, pose: Pose::new(i as f64, 0.5, 0.1) }).collect();
        write_trajectory(directory.path(), FINAL_TRAJECTORY, &rows).unwrap();
        assert_eq!(read_trajectory(directory.path(), FINAL_TRAJECTORY).unwrap(), rows);
        let cells = (0..6).map(|i| Cell { occupied: i, free: 7 * i }).collect();
        let map = StoredMap { width: 3, height: 2, cell_size_m: 0.05, origin: Point::new(-1.0, 2.0), cells };
        write_map(directory.path(), &map).unwrap();
        assert_eq!(read_map(directory.path()).unwrap(), map);
        for name in [FINAL_TRAJECTORY, FUSED_MAP] {
            let path = directory.path().join(name);
            let bytes = fs::read(&path).unwrap();
            fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        }
        assert!(
            read_trajectory(directory.path(), FINAL_TRAJECTORY).is_err()
                && read_map(directory.path()).is_err()
        );
    }
}
