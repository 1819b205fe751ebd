//! Writes what nothing connects with the map: each part gets a map and a trajectory of its own.

use super::fuser::Fuser;
use crate::{DetachedPart, PlacedScan, Solution};
use flockslam_results::flock_files::NamedPose;
use flockslam_results::{self as results, DetachedRow, StampedPose, SubmapStore};
use flockslam_stage::{StageContext, StageError};

/// Parts that get a map of their own at most: a robot that is lost again and again has many short ones.
const MAPS_MAX: usize = 8;

/// Writes the parts of a solution that are not in the map into subdirectories of the results, the longest ones with a map; gives
/// their rows for the summary. `scans` are the final poses of all scans.
///
/// # Errors
/// When the store or the disk fails.
pub(super) fn write_detached(
    solution: &Solution,
    scans: &[NamedPose],
    store: &SubmapStore,
    context: &mut StageContext,
) -> Result<Vec<DetachedRow>, StageError> {
    let begin_ns = scans.first().map_or(0, |row| row.stamp_ns);
    let mut rows = Vec::new();
    for (number, part) in solution.detached.iter().enumerate() {
        context.alive();
        let directory = if number < MAPS_MAX { write_part(part, store.clone(), context)? } else { None };
        rows.push(row(part, begin_ns, directory));
    }
    Ok(rows)
}

fn row(part: &DetachedPart, begin_ns: i64, directory: Option<String>) -> DetachedRow {
    let seconds = |stamp_ns: i64| stamp_ns.saturating_sub(begin_ns) as f64 * 1e-9;
    DetachedRow {
        trajectory: part.trajectory,
        scans: part.scans.len() as u64,
        travel_m: part.travel_m,
        from_s: part.scans.first().map_or(0.0, |scan| seconds(scan.stamp_ns)),
        to_s: part.scans.last().map_or(0.0, |scan| seconds(scan.stamp_ns)),
        directory,
    }
}

/// The name of the subdirectory; `None` when nothing was mapped.
fn write_part(
    part: &DetachedPart,
    store: SubmapStore,
    context: &StageContext,
) -> Result<Option<String>, StageError> {
    let map = Fuser::of_part(store, &part.submaps)?;
    if map.width == 0 {
        return Ok(None);
    }
    // People count from 1.
    let name = format!("trajectory-{}", part.trajectory + 1);
    let directory = context.result_dir.join(&name);
    std::fs::create_dir_all(&directory).map_err(|error| StageError::file(&directory, error))?;
    let stamped = |scan: &PlacedScan| StampedPose { stamp_ns: scan.stamp_ns, pose: scan.map_from_base };
    results::write_trajectory(&directory, results::FINAL_TRAJECTORY, part.scans.iter().map(stamped).map(Ok))?;
    results::write_map(&directory, &map)?;
    Ok(Some(name))
}
