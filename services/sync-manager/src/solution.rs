use flockslam_geometry::Pose;
use flockslam_messages::ScanId;

/// What the back end concludes at the end of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// A pose for every scan whose pose was published, in that order.
    pub trajectory: Vec<PlacedScan>,
    /// Where each of the mapper's submaps belongs, by number.
    pub submaps: Vec<PlacedSubmap>,
    /// What became of the loops.
    pub closures: ClosureCounts,
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

/// Where a submap of the mapper belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedSubmap {
    /// Its number.
    pub number: u32,
    /// Takes the coordinates that its evidence was inserted in (the front end's `odom`) to the final map.
    pub map_from_odom: Pose,
}

/// What became of the loops.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClosureCounts {
    /// Branch-and-bound searches.
    pub searches: u64,
    /// Searches that found a pose with enough score.
    pub matches: u64,
    /// Loops that passed all checks of their own.
    pub accepted: u64,
    /// Of those, loops that the robust solution does not let act.
    pub revoked: u64,
    /// Nodes of the graph.
    pub nodes: u64,
    /// Nodes whose match to the nodes before them was not believed.
    pub unmatched: u64,
}
