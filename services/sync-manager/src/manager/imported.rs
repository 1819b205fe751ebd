//! An imported map, as the first nodes of the graph: their poses are given, and what is driven is moved to them.

use super::SyncManager;

impl SyncManager {
    /// Submaps of an imported map: those with numbers below this. They stay as they are, where they are.
    pub fn imported_submaps(&self) -> u32 {
        let given = self.records.iter().take_while(|record| record.is_given);
        given.last().map_or(0, |last| last.submap + 1)
    }

    /// Puts the nodes of an imported map exactly where they are: what a solver leaves of them is rounded.
    pub(super) fn hold_given(&mut self) {
        for (pose, node) in self.poses.iter_mut().zip(self.odometry.given_nodes()) {
            *pose = node.local_pose;
        }
    }
}
