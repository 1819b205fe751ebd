//! How many loops were searched for, found, accepted and revoked so far.

use super::SyncManager;
use crate::ClosureCounts;
use flockslam_loop_closure::connectivity::TrajectoryConnectivity;
use flockslam_results::Unattached;

impl SyncManager {
    /// Counts of loops so far.
    pub fn closure_counts(&self) -> ClosureCounts {
        self.counts(&self.connectivity(self.odometry.nodes().len()))
    }

    /// The scans so far that nothing connects with the map.
    pub fn unattached(&self) -> Unattached {
        self.driven.unattached(&self.connectivity(self.poses.len()))
    }

    pub(super) fn counts(&self, connectivity: &TrajectoryConnectivity) -> ClosureCounts {
        let (counts, open) = (self.finder.counts(), self.open_finder.counts());
        ClosureCounts {
            searches: counts.searches + open.searches,
            matches: counts.matches + open.matches,
            accepted: self.closures.len() as u64 + self.frozen_closures,
            revoked: self.is_inlier.iter().filter(|&&is_inlier| !is_inlier).count() as u64,
            nodes: self.odometry.nodes().len() as u64,
            unmatched: self.odometry.unmatched() as u64,
            trajectories: connectivity.count() as u64,
            detached_scans: self.driven.unattached(connectivity).scans,
        }
    }
}
