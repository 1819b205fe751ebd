//! How many loops were searched for, found, accepted and revoked so far.

use super::SyncManager;
use crate::ClosureCounts;

impl SyncManager {
    /// Counts of loops so far.
    pub fn closure_counts(&self) -> ClosureCounts {
        self.counts(&self.connectivity(self.odometry.nodes().len()))
    }
}
