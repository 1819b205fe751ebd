//! What the back end concludes while the robot drives: loops at each new node and at each closed submap, and the correction that follows.

use super::{NODE_DISTANCE_M, SEARCHES_PER_SUBMAP, SOLVING_PER_SUBMAP, SyncManager};
use flockslam_geometry::Pose;
use flockslam_messages::{Correction, ScanId, SubmapClosed};
use flockslam_registration::cloud::Placement;

/// The correction is the mean of what so many of the newest nodes say: a single one has the noise of its match, which every pose up to
/// the next node would have.
const CORRECTION_NODES: usize = 5;
/// Nodes farther back than this do not count: the front end drifts, metres.
const CORRECTION_M: f64 = 3.0 * CORRECTION_NODES as f64 * NODE_DISTANCE_M;

/// Closures that are off by less from the last solution wait for the next closed submap, metres and radians.
const SURPRISE: (f64, f64) = (0.03, 0.01);

/// What was concluded last.
#[derive(Debug, Default)]
pub(super) struct Concluded {
    /// Sequence of the newest node then.
    node: Option<u64>,
    /// Searches when the last submap was closed.
    pub(super) searches: u64,
    correction: Option<Correction>,
}

impl SyncManager {
    /// Concludes what can be concluded after a scan that has entered the map, and gives the correction of the front end. When the scan is
    /// a node, loops are looked for, and the graph is solved when there are new ones. To be called after [`Self::pose`] and
    /// [`Self::node`]; a caller that leaves it out has the same at closed submaps.
    pub fn scan_accepted(&mut self, id: ScanId) -> Correction {
        let newest = self.odometry.nodes().last().map(|node| node.sequence);
        if let Some(last) = self.concluded.correction.filter(|_| self.concluded.node == newest) {
            return Correction { run: id.run, scan: id.sequence, ..last };
        }
        let submap = self.concluded.correction.map_or(0, |last| last.submap);
        self.conclude(id, submap, false)
    }

    /// Concludes what can be concluded after a closed submap of the mapper: as after a scan, with new credit for searches and solving, and
    /// nodes that are constrained well enough are frozen.
    pub fn submap_closed(&mut self, notice: &SubmapClosed) -> Correction {
        let most = self.solving_cost.max(SOLVING_PER_SUBMAP);
        self.solving_credit = (self.solving_credit + SOLVING_PER_SUBMAP).min(most);
        let correction = self.conclude(notice.last, notice.number, true);
        self.concluded.searches = self.finder.counts().searches;
        self.collect_findings(self.nodes_up_to(notice.last.sequence));
        self.freeze(self.odometry.nodes().len());
        correction
    }

    fn conclude(&mut self, id: ScanId, submap: u32, at_submap: bool) -> Correction {
        let known = self.odometry.nodes().len();
        self.close_loops(known, SEARCHES_PER_SUBMAP, at_submap);
        self.revision += 1;
        let connectivity = self.connectivity(known);
        let correction = Correction {
            map_from_odom: self.map_from_odom(known),
            scan: id.sequence,
            run: id.run,
            submap,
            revision: self.revision,
            closures: self.is_inlier.iter().filter(|&&is_inlier| is_inlier).count() as u32,
            trajectory: self.entries.number_of_front_end(connectivity.newest()),
            attached: u32::from(connectivity.is_attached(connectivity.newest())),
        };
        self.concluded.node = self.odometry.nodes().last().map(|node| node.sequence);
        self.concluded.correction = Some(correction);
        correction
    }

    /// Whether a closure from number `first` on contradicts the last solution.
    pub(super) fn surprise(&self, first: usize) -> bool {
        self.closures[first..].iter().any(|closure| {
            let edge = &closure.edge;
            let expected = self.poses[edge.from].to(self.poses[edge.to]);
            expected.distance_m(&edge.motion) > SURPRISE.0 || expected.turn_rad(&edge.motion) > SURPRISE.1
        })
    }

    /// Number of nodes whose scans are not newer than `sequence`.
    fn nodes_up_to(&self, sequence: u64) -> usize {
        self.odometry.nodes().partition_point(|node| node.sequence <= sequence)
    }

    /// `map_from_odom` as the last of the first `known` nodes say it, where the newest of them is.
    fn map_from_odom(&self, known: usize) -> Pose {
        let nodes = self.odometry.nodes();
        let Some(last) = known.checked_sub(1) else { return Pose::IDENTITY };
        let (newest, at) = (nodes[last], self.poses[last]);
        let counts = |i: &usize| {
            nodes[*i].trajectory == newest.trajectory && newest.travel_m - nodes[*i].travel_m <= CORRECTION_M
        };
        let correction = |i: usize| at.to(self.poses[i].compose(nodes[i].odom.to(newest.odom)));
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for off in (0..known).rev().take(CORRECTION_NODES).take_while(counts).map(correction) {
            sum = [sum[0] + off.x_m, sum[1] + off.y_m, sum[2] + off.heading_rad];
            count += 1.0;
        }
        let [x_m, y_m, heading_rad] = sum.map(|v| v / count);
        at.compose(Placement::new(x_m, y_m, heading_rad)).compose(newest.odom.inverse()).pose()
    }
}
