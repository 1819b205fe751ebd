//! The common solution: solves the graph of all robots, with closures between robots on trial, and gives the poses of all nodes and submaps in one frame.

use super::inspection::Inspected;
use super::start::start;
use super::{Flock, FlockGraph};
use flockslam_geometry::Pose;
use flockslam_loop_closure::closure::CHI_SQUARED_MAX;
use flockslam_loop_closure::connectivity::TrajectoryConnectivity;
use flockslam_loop_closure::dense::DensePass;
use flockslam_loop_closure::refine::Refinement;
use flockslam_pose_graph::Edge;
use flockslam_pose_graph::{RobustSettings, solve};
use flockslam_records::RobotId;
use flockslam_registration::cloud::{MomentGrid, Placement};
use std::collections::{BTreeMap, BTreeSet};

/// What closures between robots weigh while all is measured again: enough to hold robots together that saw little in common, too little to
/// bend what is measured.
const HELD: f64 = 0.1;
/// How often closures are put on trial before robots are left apart.
const TRIALS_MAX: usize = 8;
/// How often what is expected is put on trial: what acts then leads one to expect more, more narrowly.
const EXPECTED_ROUNDS: usize = 3;

/// Poses of a graph's nodes, and what holds them together.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// By node.
    pub poses: Vec<Placement>,
    /// By closure: whether it is an inlier.
    pub is_inlier: Vec<bool>,
    /// How inlier closures connect the trajectories.
    pub connectivity: TrajectoryConnectivity,
}

/// A node in the solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedNode {
    /// Sequence of its scan.
    pub sequence: u64,
    /// Pose of the robot there, in the frame of the flock (or, for those that are not part of it, of their own part).
    pub flock_from_base: Pose,
    /// The part of the solution that it belongs to: poses of different parts have nothing to do with each other.
    pub part: u32,
}

/// Pose of a submap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedRecord {
    /// Its number.
    pub submap: u32,
    /// Takes the coordinates that its evidence was inserted in to the flock's frame.
    pub flock_from_odom: Pose,
    /// The part of the solution that it belongs to.
    pub part: u32,
}

/// Poses of all nodes and submaps of a collection of records.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlockSolution {
    /// The nodes of each log, in order.
    pub nodes: BTreeMap<(RobotId, u64), Vec<PlacedNode>>,
    /// The submaps of each log, in order.
    pub submaps: BTreeMap<(RobotId, u64), Vec<PlacedRecord>>,
    /// The part with most nodes: the flock's frame is that of the first robot in it.
    pub main_part: u32,
    /// Closures between robots: inliers and outliers.
    pub across: (u64, u64),
}

impl FlockSolution {
    /// A hash over all poses, to the bit: equal for equal solutions.
    pub fn hash(&self) -> u64 {
        let mut hash = 0xcbf2_9ce4_8422_2325u64;
        let mut mix = |word: u64| {
            hash = (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(23);
        };
        for node in self.nodes.values().flatten() {
            let Pose { x_m, y_m, heading_rad } = node.flock_from_base;
            [node.sequence, node.part.into()].into_iter().for_each(&mut mix);
            [x_m, y_m, heading_rad].into_iter().for_each(|value| mix(value.to_bits()));
        }
        hash
    }

    /// Names of the robots that are part of the flock's frame, in order.
    pub fn members(&self) -> Vec<&RobotId> {
        let inside = |nodes: &[PlacedNode]| nodes.iter().any(|node| node.part == self.main_part);
        let mut members: Vec<_> =
            self.nodes.iter().filter(|(_, nodes)| inside(nodes)).map(|((robot, _), _)| robot).collect();
        members.dedup();
        members
    }
}

impl FlockGraph {
    /// Solves the graph from the trajectories: what ties robots together first, then with all that this leads one to expect.
    pub(super) fn solve(&self, inspected: &mut Inspected) -> Solved {
        let (connected, mut more) = self.connected(inspected);
        let mut solved = connected.clone();
        for _ in 0..EXPECTED_ROUNDS {
            let expected = self.expected(&solved, inspected);
            let known = more.clone();
            expected.into_iter().for_each(|i| more[i] = true);
            if more == known {
                break;
            }
            let next = self.solve_with(&more);
            // Nothing that ties robots together may give way to what does not.
            let still_ties = (0..more.len())
                .all(|i| !(connected.is_inlier[i] && self.is_across(&self.closures[i])) || next.is_inlier[i]);
            if !still_ties {
                break;
            }
            solved = next;
        }
        solved
    }

    /// The solution with all closures on trial that agree and that what both robots have seen confirms, and what was on trial.
    /// What is left between two robots after that must still agree.
    fn connected(&self, inspected: &mut Inspected) -> (Solved, Vec<bool>) {
        let mut denied = BTreeSet::new();
        for _ in 0..TRIALS_MAX {
            let on_trial = self.eligible(&denied, inspected);
            let solved = self.solve_with(&on_trial);
            let unconfirmed = self.unconfirmed(&solved.is_inlier);
            if unconfirmed.is_empty() {
                return (solved, on_trial);
            }
            denied.extend(unconfirmed);
        }
        denied.extend((0..self.closures.len()).filter(|i| self.is_across(&self.closures[*i])));
        let on_trial = self.eligible(&denied, inspected);
        (self.solve_with(&on_trial), on_trial)
    }

    fn solve_with(&self, on_trial: &[bool]) -> Solved {
        let mut edges: Vec<Edge> = self.edges.clone();
        let fixed_count = edges.len();
        edges.extend(self.closures.iter().zip(on_trial).filter(|(_, e)| **e).map(|(c, _)| c.edge));
        let (mut poses, _) = start(&self.nodes, &edges[fixed_count..]);
        let robust = RobustSettings { chi_squared_max: CHI_SQUARED_MAX, growth: 1.6, rounds: 25, warm_up: 6 };
        let solved = solve(self.nodes.len(), &edges, fixed_count, &robust, &mut poses);
        let mut inliers = solved.weights[fixed_count..].iter().map(|&w| w > 0.5);
        let is_inlier: Vec<bool> = on_trial.iter().map(|e| *e && inliers.next() == Some(true)).collect();
        let connectivity = self.connectivity(&is_inlier);
        Solved { poses, is_inlier, connectivity }
    }

    pub(super) fn connectivity(&self, is_inlier: &[bool]) -> TrajectoryConnectivity {
        let inliers = self.closures.iter().zip(is_inlier).filter(|(_, is_inlier)| **is_inlier);
        TrajectoryConnectivity::new(&self.nodes, inliers.map(|(c, _)| (c.edge.from, c.edge.to)))
    }

    /// Measures the whole solution again: nodes near each other are matched, of one robot or of two.
    fn measure_again(&self, solved: &mut Solved, grid: &mut MomentGrid) {
        let connectivity = &solved.connectivity;
        let held = self.held_together(&solved.is_inlier);
        let pass = DensePass {
            nodes: &self.nodes,
            scans: &self.scans,
            segments: &self.segments,
            odometry: &held,
            constraints: &[],
            connectivity,
        };
        pass.run(grid, &mut solved.poses);
        let mut parts: Vec<u32> =
            (0..connectivity.count() as u32).map(|trajectory| connectivity.part(trajectory)).collect();
        parts.sort_unstable();
        parts.dedup();
        for part in parts {
            let in_map: Vec<bool> =
                self.nodes.iter().map(|node| connectivity.part(node.trajectory) == part).collect();
            let refinement = Refinement {
                nodes: &self.nodes,
                scans: &self.scans,
                odometry: &held,
                constraints: &[],
                in_map: &in_map,
            };
            refinement.run(grid, &mut solved.poses);
        }
    }

    /// The trajectories, and the closures between robots that are inliers. Odometry is not enough: no other edge that is not switchable connects robots, and where they
    /// met once, what is measured again may be too little to do so.
    fn held_together(&self, is_inlier: &[bool]) -> Vec<Edge> {
        let across = self
            .closures
            .iter()
            .zip(is_inlier)
            .filter(|(closure, is_inlier)| **is_inlier && self.is_across(closure));
        let loosely = |edge: Edge| Edge { information: edge.information.map(|v| HELD * v), ..edge };
        self.edges.iter().copied().chain(across.map(|(closure, _)| loosely(closure.edge))).collect()
    }

    /// Where everything is. With `finely`, after all of it has been matched again: for the end, since it takes a multiple of the
    /// time.
    pub fn solution(&self, finely: bool, inspected: &mut Inspected) -> FlockSolution {
        if self.is_empty() {
            return FlockSolution::default();
        }
        let mut solved = self.solve(inspected);
        if finely {
            self.measure_again(&mut solved, &mut MomentGrid::default());
        }
        self.placed(&solved)
    }

    /// A solution in the names of the records, each part in the frame of its first node.
    fn placed(&self, solved: &Solved) -> FlockSolution {
        let connectivity = &solved.connectivity;
        let mut gauges: BTreeMap<u32, Placement> = BTreeMap::new();
        let mut solution = FlockSolution::default();
        let mut sizes: BTreeMap<u32, usize> = BTreeMap::new();
        for log in &self.logs {
            let mut nodes = Vec::with_capacity(log.nodes.len());
            let mut submaps: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
            for i in log.nodes.clone() {
                let part = connectivity.part(self.nodes[i].trajectory);
                let gauge = gauges
                    .entry(part)
                    .or_insert_with(|| self.nodes[i].odom.compose(solved.poses[i].inverse()));
                *sizes.entry(part).or_default() += 1;
                nodes.push(PlacedNode {
                    sequence: self.scanned[i].sequence,
                    flock_from_base: gauge.compose(solved.poses[i]).pose(),
                    part,
                });
                submaps.entry(self.scanned[i].submap).or_default().push(i);
            }
            let place = |(submap, members): (u32, Vec<usize>)| {
                let middle = members[members.len() / 2];
                let part = connectivity.part(self.nodes[middle].trajectory);
                let at = gauges[&part].compose(solved.poses[middle]);
                let flock_from_odom = at.compose(self.nodes[middle].odom.inverse()).pose();
                PlacedRecord { submap, flock_from_odom, part }
            };
            let key = (log.robot.clone(), log.epoch);
            solution.submaps.insert(key.clone(), submaps.into_iter().map(place).collect());
            solution.nodes.insert(key, nodes);
        }
        let largest = sizes.iter().max_by_key(|(part, size)| (**size, std::cmp::Reverse(**part)));
        solution.main_part = largest.map_or(0, |(part, _)| *part);
        let across =
            self.closures.iter().zip(&solved.is_inlier).filter(|(closure, _)| self.is_across(closure));
        let (inliers, other): (Vec<_>, Vec<_>) = across.partition(|(_, is_inlier)| **is_inlier);
        solution.across = (inliers.len() as u64, other.len() as u64);
        solution
    }
}

impl Flock {
    /// Where everything is of which this robot has records; with `finely`, matched again as a whole.
    pub fn solution(&self, finely: bool) -> FlockSolution {
        let graph = FlockGraph::new(self.collection());
        graph.solution(finely, &mut self.inspected())
    }
}
