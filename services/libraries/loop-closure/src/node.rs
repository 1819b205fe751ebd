//! Nodes of the graph: scans that were inserted, some decimetres apart.

use flockslam_registration::cloud::Placement;

/// Information that one unit of an alignment's normalised sum is worth, 1/m²: a wall seen by all points fixes
/// its distance to about 7 mm.
pub const POINT_INFORMATION: f64 = 4e4;
/// The drift bound where another trajectory begins, metres: more than any path is long.
pub const BROKEN_M: f64 = 1e6;

/// A scan in the graph.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Its number in the store of scans.
    pub scan: usize,
    /// Sequence of its scan: its name, which it keeps when other nodes are taken out.
    pub sequence: u64,
    /// Pose from the front end, continuous.
    pub odom: Placement,
    /// Pose from matching each node to the ones before it; never corrected by a loop.
    pub local_pose: Placement,
    /// Where a solver starts from: the local_pose, or, where the solution is frozen, the solution.
    pub start: Placement,
    /// Length of the path up to here, metres.
    pub travel_m: f64,
    /// The same, increased where a node could not be matched: the size of a search window grows with it,
    /// metres.
    pub drift_bound_m: f64,
    /// Trajectory that it belongs to, counted from 0: relative poses of trajectories are known from closures alone.
    pub trajectory: u32,
    /// Whether its pose follows from surfaces far apart, as in the open: clouds of points do not hold it.
    pub is_open: bool,
    /// Whether its pose is given, as in an imported map: nothing moves it, and its local pose is its pose in the map.
    pub is_given: bool,
}

impl Node {
    /// Whether the passes over all nodes leave it where it is.
    pub(crate) fn is_held(&self) -> bool {
        self.is_open || self.is_given
    }
}

/// A scan that becomes a node.
#[derive(Clone, Copy, Debug)]
pub struct NewNode {
    /// Sequence of the scan.
    pub sequence: u64,
    /// Its number in the store of scans.
    pub scan: usize,
    /// Pose from the front end.
    pub odom: Placement,
    /// Its trajectory.
    pub trajectory: u32,
    /// Pose by odometry, if the robot has any.
    pub odometry: Option<Placement>,
    /// Whether odometry connects its trajectory, which begins with it, with the one before.
    pub continues: bool,
    /// Whether its pose follows from surfaces far apart.
    pub is_open: bool,
    /// Whether its pose, that from the front end, is given.
    pub is_given: bool,
    /// Standard deviations of its pose as the front end publishes them: metres and radians.
    pub sigmas: (f64, f64),
}

impl NewNode {
    /// The node at its place in the local_pose, at the beginning of the path.
    pub(crate) fn at(self, local_pose: Placement, start_from_local: Placement) -> Node {
        let NewNode { sequence, scan, odom, trajectory, is_open, is_given, .. } = self;
        let start = start_from_local.compose(local_pose);
        Node {
            scan,
            sequence,
            odom,
            local_pose,
            start,
            travel_m: 0.0,
            drift_bound_m: 0.0,
            trajectory,
            is_open,
            is_given,
        }
    }
}
