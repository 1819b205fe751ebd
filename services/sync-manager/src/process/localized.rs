//! What the shell does for a back end that localizes: it loads the known map, publishes the belief, obeys orders, and stores the results of
//! the end.

use super::SyncProcess;
use crate::{DetachedPart, LocalizingManager, Solution};
use flockslam_evidence::CellState;
use flockslam_localisation::{Belief, Hypothesis, KnownMap, Surroundings};
use flockslam_results::{
    self as results, DetachedRow, HypothesisRow, KNOWN_MAP, LocalisationStatus, MapReader,
};
use flockslam_stage::{Mode, StageContext, StageError};
use std::path::Path;

impl SyncProcess {
    /// Publishes the belief about the pose in the known map, when that has changed.
    pub(super) fn localized(&mut self, context: &StageContext) -> Result<(), StageError> {
        let Some(localizing) = self.logic.localizing() else { return Ok(()) };
        self.trajectories.frozen(&localizing.take_frozen());
        let (belief, stamp_ns) = localizing.belief();
        let is_known = self
            .localisation
            .as_ref()
            .is_some_and(|last| last.stamp_ns == stamp_ns && last.knowledge == belief.knowledge.name());
        if !self.is_active || is_known {
            return Ok(());
        }
        let status = status(localizing);
        // In exact replay corrections have fixed places: after each scan that enters the map.
        let seen = self.pose.filter(|_| context.mode == Mode::Live);
        let correction = seen.and_then(|pose| localizing.fresh_correction(pose.id));
        if let Err(error) = status.write(&context.status_dir) {
            tracing::warn!(%error, "the status does not say where the robot is");
        }
        self.localisation = Some(status);
        match correction {
            Some(correction) => {
                self.correction = Some(correction);
                self.correct(&correction)
            }
            None => Ok(()),
        }
    }

    /// Handles requests for a new global localization.
    pub(super) fn obey(&mut self) -> Result<(), StageError> {
        while let Some(order) = self.orders.receive()? {
            if let Some(localizing) = self.logic.localizing() {
                localizing.relocalize(&order);
            }
        }
        Ok(())
    }

    /// Concludes a run that localized.
    pub(super) fn finish_localizing(&mut self, directory: &Path) -> Result<(), StageError> {
        let Some(localizing) = self.logic.localizing() else { return Ok(()) };
        self.trajectories.frozen(&localizing.take_frozen());
        let solution = localizing.finish();
        self.summary.localisation = Some(localizing.summary());
        self.summary.localizes = true;
        self.trajectories.finish(&solution)?;
        store(directory)?;
        self.summary.detached = apart(&solution);
        self.summary.trajectories = solution.closures.trajectories;
        self.summary.detached_scans = solution.closures.detached_scans;
        results::write_summary(directory, &self.summary)?;
        self.finished.send(self.summary.scans)
    }
}

/// Loads the map that is in the results of a set.
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

/// The belief, as others read it.
fn status(logic: &LocalizingManager) -> LocalisationStatus {
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

/// Puts the known map where the map of a run is: it is the same to the byte.
///
/// # Errors
/// When the disk refuses.
fn store(result_dir: &Path) -> Result<(), StageError> {
    let to = result_dir.join(results::FUSED_MAP);
    std::fs::copy(result_dir.join(KNOWN_MAP), &to).map(drop).map_err(|e| StageError::file(&to, e))
}

/// Scans that were never found in the map, in the summary of a run.
fn apart(solution: &Solution) -> Vec<DetachedRow> {
    let begin_ns = solution.trajectory.first().map_or(0, |scan| scan.stamp_ns);
    let seconds = |stamp_ns: i64| stamp_ns.saturating_sub(begin_ns) as f64 * 1e-9;
    let row = |part: &DetachedPart| DetachedRow {
        trajectory: part.trajectory,
        scans: part.scans.len() as u64,
        travel_m: part.travel_m,
        from_s: part.scans.first().map_or(0.0, |scan| seconds(scan.stamp_ns)),
        to_s: part.scans.last().map_or(0.0, |scan| seconds(scan.stamp_ns)),
        directory: None,
    };
    solution.detached.iter().map(row).collect()
}
