//! The shell of a back end that localizes: loads the known map, tells others what is believed, and stores the results of the end.

use crate::{LocalizingManager, Solution};
use flockslam_evidence::CellState;
use flockslam_localisation::{Belief, Hypothesis, KnownMap, Surroundings};
use flockslam_results::{HypothesisRow, KNOWN_MAP, LocalisationStatus, MapReader};
use flockslam_stage::StageError;
use std::path::Path;

/// Loads the map that lies in the results of a set.
///
/// # Errors
/// When there is none, or it is not whole.
pub(super) fn load(result_dir: &Path) -> Result<Surroundings, StageError> {
    let reader = MapReader::open_file(result_dir.join(KNOWN_MAP))?;
    let shape = reader.shape();
    let mut map = KnownMap::of_width(shape.width, shape.cell_size_m, shape.origin);
    reader.for_each_row(|row| map.push_row(row.iter().map(CellState::of)))?;
    Ok(Surroundings::new(map.measured()))
}

/// What is believed, as others read it.
pub(super) fn status(logic: &LocalizingManager) -> LocalisationStatus {
    let (belief, stamp_ns) = logic.belief();
    LocalisationStatus {
        knowledge: belief.knowledge.name().to_owned(),
        stamp_ns,
        hypotheses: belief.hypotheses.iter().map(row).collect(),
        entropy_nat: Belief::entropy_nat(belief),
        covariance: belief.covariance,
        searches: logic.summary().searches,
        map_area_m2: logic.map_area_m2(),
    }
}

fn row(hypothesis: &Hypothesis) -> HypothesisRow {
    let at = hypothesis.map_from_base;
    HypothesisRow {
        pose: [at.x_m, at.y_m, at.heading_rad],
        weight: hypothesis.weight,
        explained: hypothesis.agreement.explained,
        contradicted: hypothesis.agreement.contradicted,
    }
}

/// Puts the known map where the map of a run lies: it is the same to the byte.
///
/// # Errors
/// When the disk refuses.
pub(super) fn store(result_dir: &Path) -> Result<(), StageError> {
    let to = result_dir.join(flockslam_results::FUSED_MAP);
    std::fs::copy(result_dir.join(KNOWN_MAP), &to).map(drop).map_err(|e| StageError::file(&to, e))
}

/// Scans that were never found in the map, in the summary of a run.
pub(super) fn apart(solution: &Solution) -> Vec<flockslam_results::DetachedRow> {
    let begin_ns = solution.trajectory.first().map_or(0, |scan| scan.stamp_ns);
    let seconds = |stamp_ns: i64| stamp_ns.saturating_sub(begin_ns) as f64 * 1e-9;
    let row = |part: &crate::DetachedPart| flockslam_results::DetachedRow {
        trajectory: part.trajectory,
        scans: part.scans.len() as u64,
        travel_m: part.travel_m,
        from_s: part.scans.first().map_or(0.0, |scan| seconds(scan.stamp_ns)),
        to_s: part.scans.last().map_or(0.0, |scan| seconds(scan.stamp_ns)),
        directory: None,
    };
    solution.detached.iter().map(row).collect()
}
