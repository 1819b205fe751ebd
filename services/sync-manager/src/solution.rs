//! The result of the back end: poses of scans and submaps, and counts of closures.

use flockslam_geometry::Pose;
use flockslam_map_fusion::PlacedSubmap;
use flockslam_messages::ScanId;

/// The result of the back end at the end of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// A pose for every scan whose pose was published and that has not frozen, in that order.
    pub trajectory: Vec<PlacedScan>,
    /// Poses of the nodes of the graph by their sequence, in rising order: frozen scans are relative to them.
    pub anchors: Vec<(u64, Pose)>,
    /// Where each of the mapper's submaps belongs, by number.
    pub submaps: Vec<PlacedSubmap>,
    /// Counts of loops.
    pub closures: ClosureCounts,
    /// What nothing connects with the map, the longest first.
    pub detached: Vec<DetachedPart>,
}

/// Connected trajectories that nothing connects with the map. Their poses are relative to each other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DetachedPart {
    /// Number of the first trajectory.
    pub trajectory: u32,
    /// Poses of its scans.
    pub scans: Vec<PlacedScan>,
    /// Way driven, metres.
    pub travel_m: f64,
    /// Where its submaps lie relative to each other.
    pub submaps: Vec<PlacedSubmap>,
}

/// The anchor of scans that have their final poses in the map frame: no node has this sequence.
pub const MAP_ANCHOR: u64 = u64::MAX;

/// A scan whose pose relative to a node will not be measured again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrozenScan {
    /// The scan.
    pub id: ScanId,
    /// Its sensor stamp, nanoseconds.
    pub stamp_ns: i64,
    /// Sequence of the node, or [`MAP_ANCHOR`].
    pub anchor: u64,
    /// The robot's pose, seen from the node.
    pub anchor_from_base: Pose,
}

impl Solution {
    /// The pose of an anchor of frozen scans; none where it is not a node of the solution.
    pub fn anchor(&self, anchor: u64) -> Option<Pose> {
        if anchor == MAP_ANCHOR {
            return Some(Pose::IDENTITY);
        }
        let place = self.anchors.binary_search_by_key(&anchor, |anchor| anchor.0).ok()?;
        Some(self.anchors[place].1)
    }
}

/// The final pose of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedScan {
    /// The scan.
    pub id: ScanId,
    /// Its sensor stamp, nanoseconds.
    pub stamp_ns: i64,
    /// The robot's pose.
    pub map_from_base: Pose,
}

/// Counts of loops.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClosureCounts {
    /// Branch-and-bound searches.
    pub searches: u64,
    /// Searches that found a pose with enough score.
    pub matches: u64,
    /// Loops that passed all checks of their own.
    pub accepted: u64,
    /// Of those, loops that are outliers in the robust solution.
    pub revoked: u64,
    /// Nodes of the graph.
    pub nodes: u64,
    /// Nodes whose match to the nodes before them was rejected.
    pub unmatched: u64,
    /// Trajectories: more than one when the robot was lost.
    pub trajectories: u64,
    /// Scans of trajectories that no closure connects with the map.
    pub detached_scans: u64,
}
