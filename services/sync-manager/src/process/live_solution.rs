//! What a live set shows of the solution while it drives: poses of submaps, loops, and what is not connected with the map.

use super::SyncProcess;
use flockslam_geometry::Pose;
use flockslam_map_fusion::PlacedSubmap;
use flockslam_results::{self as results, LivePoses, SubmapRow, Unattached};
use flockslam_stage::StageContext;

impl SyncProcess {
    /// Says what nothing connects with the map, when that has changed. A failure has no other effect.
    pub(super) fn report_unattached(&mut self, unattached: Unattached, context: &StageContext) {
        if unattached == self.unattached {
            return;
        }
        self.unattached = unattached;
        self.metrics.unattached(&unattached);
        if let Err(error) = unattached.write(&context.status_dir) {
            tracing::warn!(%error, "the status does not say what is not in the map");
        }
    }

    /// Writes the solution for readers. A failure has no other effect.
    pub(super) fn show(&mut self) {
        let Some(mapping) = self.logic.mapping().filter(|_| self.is_watched) else { return };
        let counts = mapping.closure_counts();
        let live = LivePoses {
            submaps: rows(&mapping.submap_poses()),
            closures: mapping.loops(),
            searches: counts.searches,
            accepted: counts.accepted,
        };
        if let Err(error) = results::write_live_poses(&self.result_dir, &live) {
            tracing::warn!(%error, "the solution is not shown");
        }
    }
}

fn rows(submaps: &[PlacedSubmap]) -> Vec<SubmapRow> {
    let numbers = |pose: Pose| [pose.x_m, pose.y_m, pose.heading_rad];
    let row = |placed: &PlacedSubmap| SubmapRow {
        number: placed.number,
        map_from_odom: numbers(placed.map_from_odom),
    };
    submaps.iter().map(row).collect()
}
