//! The odometry graph: each inserted scan, some decimetres apart, is matched to the nodes before it. Gives nodes with poses that drift smoothly, and an
//! edge with its information from each node to the next.

use crate::node::{BROKEN_M, NewNode, Node, POINT_INFORMATION};
use crate::scans::ScanStore;
use crate::segment::{Segment, cloud, picked, scan_cloud};
use crate::smoothing::smoothed;
use flockslam_geometry::Covariance;
use flockslam_odometry_noise::OdometryNoise;
use flockslam_pose_graph::Edge;
use flockslam_pose_graph::{Symmetric, in_frame, inflated};
use flockslam_registration::cloud::{
    AlignSettings, Aligner, Alignment, MomentGrid, Placement, PooledField, Searcher, Window,
};
use std::ops::Range;

/// A match that moves farther from the front end's prediction than this is rejected, metres and radians.
const MOVE_MAX: (f64, f64) = (0.2, 0.12);
/// Scans with fewer points are not matched.
const POINTS_MIN: usize = 20;
/// Least share of points on lines of an accepted match.
const INLIERS_MIN: f64 = 0.5;
/// Largest root mean square distance of those from their lines; points spread evenly over the gate have 0.087
/// m.
const SPREAD_MAX_M: f64 = 0.055;
/// Search window after a rejected match.
const RESCUE: Window = Window { reach_m: 1.5, turn_rad: 1.0 };
/// Least score of a match in a rescue, and least share of points on lines after its refinement.
const RESCUE_MIN: (f64, f64) = (0.55, 0.65);
/// A runner-up in a rescue is at least this far away …
const APART: Window = Window { reach_m: 0.4, turn_rad: 0.2 };
/// … and makes the rescue ambiguous when its score reaches this share of the best.
const RUNNER_UP: f64 = 0.9;
/// Points of a scan in a rescue.
const RESCUE_POINTS: usize = 150;
/// A node without a match, and without odometry that agrees with the front end, is as uncertain as this much travel, metres.
const UNMATCHED_DRIFT_M: f64 = 8.0;
/// The front end's motion is accepted where odometry agrees with it within this, metres and radians.
const FOLLOWED: (f64, f64) = (0.1, 0.1);
/// Where it is, without a match, the drift bound grows so many times faster than the travel.
const FOLLOWED_DRIFT: f64 = 2.0;
/// In the open the front end's motion errs over a metre of travel as much as its pose is uncertain there: how firmly surfaces hold
/// single scans decides how a drive bends. Bounds of the standard deviations, metres and radians; a share of that of the position. On
/// simulated campuses the error over √m grows from the lower bounds to the upper ones with the published standard deviation.
const OPEN_SIGMA_MIN: (f64, f64) = (0.02, 0.0009);
const OPEN_SIGMA_MAX: (f64, f64) = (0.05, 0.006);
const OPEN_POSITION_SHARE: f64 = 0.8;
/// A turn counts as so much travel, metres per radian.
const OPEN_TURN_M: f64 = 1.0;
/// Matches that scatter so many times more than they claim, in variance, are compared with odometry …
const SCATTERING: f64 = 2.0;
/// … and not accepted where they miss it by more than this, in variances: four standard deviations.
const IMPROBABLE: f64 = 16.0;
/// How firmly a node whose pose is given is held at it (information): a tenth of a millimetre where matches say some millimetres.
const GIVEN: Symmetric = [1e8, 0.0, 0.0, 1e8, 0.0, 1e8];
/// Standard deviations of odometry while the robot was lost, metres and radians, beyond so many times what it usually has: the
/// reason for which it was lost may have moved it.
const LOST_SIGMA: (f64, f64) = (0.3, 0.05);
const LOST_FACTOR: f64 = 3.0;
/// Least standard deviations of such a motion, metres and radians.
const FOLLOWED_SIGMA: (f64, f64) = (0.01, 0.003);
/// Each node is matched again to this many before it: enough for a stable map around the robot, few enough that the front end's
/// errors stay small within.
const WINDOW_NODES: usize = 20;
/// The nodes that are matched to must lie within this of each other, metres, so that all points fit on the
/// grid's torus.
const WINDOW_MAX_M: f64 = 10.0;

/// Where odometry alone connects a trajectory with the one before: the robot was lost there, and nothing contradicts odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Sequence of the first node of the trajectory.
    pub sequence: u64,
    /// Standard deviations of the motion from the node before: metres and radians.
    sigmas: (f64, f64),
    motion: Placement,
}

/// How a new node was connected to the ones before it.
#[derive(Clone, Copy)]
enum Link {
    Matched(Alignment),
    Rescued(Alignment),
    /// Not matched: the front end's motion, with which odometry agrees.
    Followed,
    /// In the open: the front end's motion, which surfaces far apart have given, and its standard deviations over a metre.
    Open(f64, f64),
    Predicted,
    Broken,
    /// Both poses are given.
    Given,
}

/// The nodes in order, each matched again to the few before it.
///
/// A front end that matches to a large map snaps to old parts of it, and each snap is an error in its
/// relative poses. Matching again to a short window gives edges that drift smoothly, which a graph can
/// correct.
pub struct OdometryGraph {
    nodes: Vec<Node>,
    edges: Vec<Edge>,
    /// By edge: its motion as it was matched, before smoothing.
    matched_motions: Vec<Placement>,
    grid: MomentGrid,
    /// First node whose points are in the grid.
    first: usize,
    /// Takes local poses to where the solver starts.
    start_from_local: Placement,
    aligner: Aligner,
    searcher: Searcher,
    unmatched: usize,
    /// Odometry at the last node.
    odometry: Option<Placement>,
    /// Where odometry connects a trajectory with the one before.
    joints: Vec<Joint>,
    /// The error of the front end's motion, as matches show it.
    noise: OdometryNoise,
}

impl Default for OdometryGraph {
    fn default() -> Self {
        Self {
            nodes: Vec::new(),
            edges: Vec::new(),
            matched_motions: Vec::new(),
            grid: MomentGrid::default(),
            first: 0,
            start_from_local: Placement::IDENTITY,
            aligner: Aligner::new(AlignSettings::default()),
            searcher: Searcher::default(),
            unmatched: 0,
            odometry: None,
            joints: Vec::new(),
            noise: OdometryNoise::default(),
        }
    }
}

impl OdometryGraph {
    /// The nodes.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The edges: number k leads from node k to k + 1.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The edges before smoothing, for a pass that matches nodes to the segments behind them itself: such a match must count once.
    pub fn matched_edges(&self) -> Vec<Edge> {
        self.edges
            .iter()
            .zip(&self.matched_motions)
            .map(|(edge, matched)| Edge { motion: *matched, ..*edge })
            .collect()
    }

    /// Nodes whose match was rejected.
    pub fn unmatched(&self) -> usize {
        self.unmatched
    }

    /// Adds a node: the next in time, with the points of its scan.
    pub fn extend(&mut self, new: NewNode, scans: &ScanStore) {
        assert!(
            !new.is_given || self.nodes.last().is_none_or(|last| last.is_given),
            "an imported map comes first"
        );
        let node = match self.nodes.last() {
            None => new.at(new.odom, self.start_from_local),
            Some(&last) => self.matched(last, new, scans),
        };
        self.nodes.push(node);
        self.odometry = new.odometry;
        self.slide(scans);
    }

    /// Takes out the nodes of `range`, which must lie behind the first node and before the window that new nodes are matched
    /// to, and connects those around them as they lie in the solution `poses`, known so well. Solvers start from this solution
    /// from now on.
    pub fn take_out(&mut self, range: Range<usize>, poses: &[Placement], known: Symmetric) {
        assert!(range.start > 0 && range.end < self.first, "nodes in use stay");
        let (before, after) = (range.start - 1, range.end);
        let bridge = poses[before].to(poses[after]);
        self.start_from_local = poses[after].compose(self.nodes[after].local_pose.inverse());
        for (node, pose) in self.nodes.iter_mut().zip(poses).take(range.start) {
            node.start = *pose;
        }
        for node in &mut self.nodes[after..] {
            node.start = self.start_from_local.compose(node.local_pose);
        }
        self.nodes.drain(range.clone());
        self.edges.drain(range.clone());
        self.matched_motions.drain(range.clone());
        self.matched_motions[before] = bridge;
        let edge = &mut self.edges[before];
        (edge.motion, edge.information) = (bridge, known);
        for (number, edge) in self.edges.iter_mut().enumerate().skip(before) {
            (edge.from, edge.to) = (number, number + 1);
        }
        self.first -= range.len();
    }

    /// Smooths two successive segments once the second is complete: their nodes but the first move, and those behind move with them.
    /// `grid` is empty before and after.
    ///
    /// # Panics
    /// When the segments do not follow each other.
    pub fn smooth(&mut self, segments: [&Segment; 2], scans: &ScanStore, grid: &mut MomentGrid) {
        let [start, end] = [segments[0].nodes.start, segments[1].nodes.end];
        let poses = smoothed(&self.nodes, &self.edges, scans, segments, grid);
        self.withdraw_window(scans);
        let moved = poses[end - 1 - start].compose(self.nodes[end - 1].local_pose.inverse());
        for (i, node) in self.nodes[start..].iter_mut().enumerate() {
            node.local_pose = poses.get(i).copied().unwrap_or_else(|| moved.compose(node.local_pose));
            node.start = self.start_from_local.compose(node.local_pose);
        }
        for number in start..end - 1 {
            self.edges[number].motion = self.nodes[number].local_pose.to(self.nodes[number + 1].local_pose);
        }
        for node in &self.nodes[self.first..] {
            self.grid.add(&node.local_pose, scans.points(node.scan));
        }
    }

    /// Renames the scans of all nodes.
    pub fn rename_scans(&mut self, renamed: &[usize]) {
        self.nodes.iter_mut().for_each(|node| node.scan = renamed[node.scan]);
    }

    fn matched(&mut self, last: Node, new: NewNode, scans: &ScanStore) -> Node {
        let motion = last.odom.to(new.odom);
        let guess = last.local_pose.compose(motion);
        let link = if new.is_given {
            Link::Given
        } else if new.trajectory == last.trajectory {
            self.link(&guess, &new, self.follows(&motion, &new), scans)
        } else {
            self.withdraw_all(scans);
            self.joints.extend(self.joint(&motion, &new));
            Link::Broken
        };
        let (local_pose, drift_bound_m) = match link {
            Link::Matched(found) | Link::Rescued(found) => (found.placement, 0.0),
            Link::Given => (new.odom, 0.0),
            Link::Open(..) => (guess, 0.0),
            Link::Followed => (guess, (FOLLOWED_DRIFT - 1.0) * motion.distance_m(&Placement::IDENTITY)),
            Link::Predicted => (guess, UNMATCHED_DRIFT_M),
            Link::Broken => (guess, BROKEN_M),
        };
        self.unmatched += usize::from(matches!(link, Link::Predicted | Link::Followed));
        let to = self.nodes.len();
        let by_odometry = self.odometry.zip(new.odometry).map(|(before, now)| before.to(now));
        let information = in_frame(&self.information(&link, &motion, by_odometry), &last.local_pose);
        let motion = last.local_pose.to(local_pose);
        self.edges.push(Edge { from: to - 1, to, motion, information });
        self.matched_motions.push(motion);
        let way_m = local_pose.distance_m(&last.local_pose);
        // No drift is between poses that are given.
        let drift_m = if new.is_given { 0.0 } else { way_m + drift_bound_m };
        let (travel_m, drift_bound_m) = (last.travel_m + way_m, last.drift_bound_m + drift_m);
        Node { travel_m, drift_bound_m, ..new.at(local_pose, self.start_from_local) }
    }

    /// Empties the window: nothing before here is to be matched to.
    fn withdraw_all(&mut self, scans: &ScanStore) {
        self.withdraw_window(scans);
        self.first = self.nodes.len();
    }

    fn withdraw_window(&mut self, scans: &ScanStore) {
        for node in &self.nodes[self.first..] {
            self.grid.withdraw(&node.local_pose, scans.points(node.scan));
        }
    }

    /// The constraint that odometry gives between the last node and a new one of another trajectory, its covariance inflated.
    fn joint(&self, motion: &Placement, new: &NewNode) -> Option<Joint> {
        let by_odometry = self.odometry.zip(new.odometry).filter(|_| new.continues)?;
        let by_odometry = by_odometry.0.to(by_odometry.1);
        let way_m = (by_odometry.x_m * by_odometry.x_m + by_odometry.y_m * by_odometry.y_m).sqrt();
        let (position, heading) = self.noise.variances(way_m, by_odometry.heading_rad.abs());
        let sigmas = (
            LOST_SIGMA.0 + LOST_FACTOR * position.sqrt() + by_odometry.distance_m(motion),
            LOST_SIGMA.1 + LOST_FACTOR * heading.sqrt() + by_odometry.turn_rad(motion),
        );
        Some(Joint { sequence: new.sequence, sigmas, motion: by_odometry })
    }

    /// The constraints by odometry between trajectories among the first `known` nodes: switchable, unlike [`Self::edges`].
    pub fn joints(&self, known: usize) -> impl Iterator<Item = Edge> {
        self.joints.iter().filter_map(move |joint| {
            let nodes = &self.nodes[..known];
            let to = nodes.binary_search_by_key(&joint.sequence, |node| node.sequence).ok()?;
            let from = to.checked_sub(1).filter(|from| nodes[*from].trajectory != nodes[to].trajectory)?;
            let information = diagonal(joint.sigmas.0, joint.sigmas.1);
            Some(Edge { from, to, motion: joint.motion, information })
        })
    }

    /// What holds the nodes whose poses are given at these: constraints to the first of them. Trusted, like [`Self::edges`].
    pub fn given(&self) -> impl Iterator<Item = Edge> {
        let nodes = self.given_nodes();
        let of_first = move |to: usize| Edge {
            from: 0,
            to,
            motion: nodes[0].local_pose.to(nodes[to].local_pose),
            information: GIVEN,
        };
        (1..nodes.len()).map(of_first)
    }

    /// The nodes whose poses are given: the first ones.
    pub fn given_nodes(&self) -> &[Node] {
        &self.nodes[..self.nodes.partition_point(|node| node.is_given)]
    }

    /// Whether odometry agrees with the front end's motion to a node.
    fn follows(&self, motion: &Placement, new: &NewNode) -> bool {
        let (Some(before), Some(now)) = (self.odometry, new.odometry) else { return false };
        let by_odometry = before.to(now);
        by_odometry.distance_m(motion) <= FOLLOWED.0 && by_odometry.turn_rad(motion) <= FOLLOWED.1
    }

    /// Learns from a match how far odometry is off, and how much matches scatter. Gives whether the match is accepted: where
    /// matches scatter more than they claim, odometry must not make it improbable.
    fn learns(&mut self, found: &Alignment, new: &NewNode) -> bool {
        let (Some(odometry), Some(before), Some(last)) = (new.odometry, self.odometry, self.nodes.last())
        else {
            return true;
        };
        let claimed = claimed(found);
        self.noise.learn(found.placement.pose(), odometry.pose(), claimed);
        if self.noise.excess() < SCATTERING {
            return true;
        }
        let (by_odometry, found) = (before.to(odometry), last.local_pose.to(found.placement));
        let way_m = (by_odometry.x_m * by_odometry.x_m + by_odometry.y_m * by_odometry.y_m).sqrt();
        let (position, heading) = self.noise.variances(way_m, by_odometry.heading_rad.abs());
        let of_match = self.noise.inflated(claimed);
        let (off_m, off_rad) = (by_odometry.distance_m(&found), by_odometry.turn_rad(&found));
        off_m * off_m <= IMPROBABLE * (position + of_match.xx.max(of_match.yy))
            && off_rad * off_rad <= IMPROBABLE * (heading + of_match.tt)
    }

    fn link(&mut self, guess: &Placement, new: &NewNode, follows: bool, scans: &ScanStore) -> Link {
        let scan = new.scan;
        if new.is_open {
            return Link::Open(
                (OPEN_POSITION_SHARE * new.sigmas.0).clamp(OPEN_SIGMA_MIN.0, OPEN_SIGMA_MAX.0),
                new.sigmas.1.clamp(OPEN_SIGMA_MIN.1, OPEN_SIGMA_MAX.1),
            );
        }
        let unmatched = if follows { Link::Followed } else { Link::Predicted };
        if scans.points(scan).len() < POINTS_MIN {
            return unmatched;
        }
        let found = self.aligner.align(&mut self.grid, scans.points(scan), *guess);
        let accepted = found.filter(|found| {
            found.inliers >= INLIERS_MIN
                && found.spread_m <= SPREAD_MAX_M
                && found.placement.distance_m(guess) <= MOVE_MAX.0
                && found.placement.turn_rad(guess) <= MOVE_MAX.1
        });
        match accepted {
            Some(found) if self.learns(&found, new) => Link::Matched(found),
            Some(_) => unmatched,
            None if follows => Link::Followed,
            None => self.rescue(guess, scan, scans).map_or(Link::Predicted, Link::Rescued),
        }
    }

    /// Looks for a scan widely among the nodes in the window: the front end has jumped, or something moves.
    fn rescue(&mut self, guess: &Placement, scan: usize, scans: &ScanStore) -> Option<Alignment> {
        let origin = self.nodes.len() - 1;
        let field = PooledField::new(&cloud(&self.nodes, scans, self.first..self.nodes.len(), origin));
        let points = picked(&scan_cloud(scans.points(scan)), RESCUE_POINTS);
        let root = self.nodes[origin].local_pose;
        let local = root.to(*guess);
        let found = self.searcher.best(&field, &points, local, RESCUE, RESCUE_MIN.0, None)?;
        let exclude = Some((found.placement, APART));
        if self.searcher.best(&field, &points, local, RESCUE, RUNNER_UP * found.score, exclude).is_some() {
            return None;
        }
        let start = root.compose(found.placement);
        let refined = self.aligner.align(&mut self.grid, scans.points(scan), start)?;
        let stays = refined.placement.distance_m(&start) <= MOVE_MAX.0
            && refined.placement.turn_rad(&start) <= MOVE_MAX.1;
        (stays && refined.inliers >= RESCUE_MIN.1 && refined.spread_m <= SPREAD_MAX_M).then_some(refined)
    }

    /// Brings the newest node's points into the grid and takes out those that fall out of the window.
    fn slide(&mut self, scans: &ScanStore) {
        let newest = self.nodes.len() - 1;
        if self.nodes[newest].is_given {
            // Nothing is matched to the node before here.
            self.first = newest + 1;
            return;
        }
        let at = self.nodes[newest].local_pose;
        while self.first < newest
            && (newest - self.first >= WINDOW_NODES
                || self.nodes[self.first].local_pose.distance_m(&at) > WINDOW_MAX_M)
        {
            let old = &self.nodes[self.first];
            self.grid.withdraw(&old.local_pose, scans.points(old.scan));
            self.first += 1;
        }
        self.grid.add(&at, scans.points(self.nodes[newest].scan));
    }

    /// Information of an odometry edge, in the grid's axes.
    fn information(&self, link: &Link, motion: &Placement, by_odometry: Option<Placement>) -> Symmetric {
        let way = (motion.x_m * motion.x_m + motion.y_m * motion.y_m).sqrt();
        let turn = motion.heading_rad.abs();
        match link {
            // In degenerate directions the front end's own motion is used.
            Link::Matched(found) => {
                let mut sum = diagonal(0.05 + 0.1 * way, 0.02 + 0.1 * turn);
                let (position, heading) = self.noise.excesses();
                let mixed = 1.0 / (position * heading).sqrt();
                let share = [1.0 / position, 1.0 / position, mixed, 1.0 / position, mixed, 1.0 / heading];
                (0..6).for_each(|i| sum[i] += share[i] * POINT_INFORMATION * found.information[i]);
                sum
            }
            Link::Rescued(found) => {
                let mut sum = diagonal(0.5, 0.3);
                (0..6).for_each(|i| sum[i] += POINT_INFORMATION * found.information[i]);
                inflated(&sum, 0.03, 0.01).unwrap_or(diagonal(0.5, 0.3))
            }
            Link::Followed => {
                let (position, heading) = self.noise.variances(way, turn);
                let (off_m, off_rad) =
                    by_odometry.map_or((0.0, 0.0), |s| (s.distance_m(motion), s.turn_rad(motion)));
                diagonal(
                    FOLLOWED_SIGMA.0 + position.sqrt() + off_m,
                    FOLLOWED_SIGMA.1 + heading.sqrt() + off_rad,
                )
            }
            Link::Open(sigma_m, sigma_rad) => {
                let root = (way + OPEN_TURN_M * turn).sqrt();
                diagonal(sigma_m * root + 1e-3, sigma_rad * root + 1e-4)
            }
            Link::Predicted => diagonal(0.3 + 0.5 * way, 0.2 + 0.5 * turn),
            // Just enough information to keep the graph connected.
            Link::Broken => diagonal(1e3, 1e2),
            Link::Given => diagonal(FOLLOWED_SIGMA.0, FOLLOWED_SIGMA.1),
        }
    }
}

/// The covariance of a match as its points claim it.
fn claimed(found: &Alignment) -> Covariance {
    let [xx, _, _, yy, _, tt] = found.information.map(|v| 1.0 / (POINT_INFORMATION * v.max(1e-6)));
    Covariance { xx: xx.min(1.0), yy: yy.min(1.0), tt: tt.min(0.1), ..Covariance::default() }
}

/// Information of independent errors with these standard deviations.
fn diagonal(sigma_m: f64, sigma_rad: f64) -> Symmetric {
    let (t, r) = (1.0 / (sigma_m * sigma_m), 1.0 / (sigma_rad * sigma_rad));
    [t, 0.0, 0.0, t, 0.0, r]
}
