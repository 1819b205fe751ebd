//! The passes over all nodes at the end: they match the nodes again and solve the graph of these matches.

use super::SyncManager;
use flockslam_loop_closure::agreement::eligible_at_the_end;
use flockslam_loop_closure::attachment::AttachmentFinder;
use flockslam_loop_closure::dense::DensePass;
use flockslam_loop_closure::finder::World;
use flockslam_loop_closure::graph_distances::graph_distances;
use flockslam_loop_closure::node::Node;
use flockslam_loop_closure::refine::Refinement;
use flockslam_loop_closure::segment::Segment;
use flockslam_pose_graph::{Edge, Marginals};
use std::collections::BTreeSet;
use std::ops::Range;

/// Searches in the open at the end, at most.
const AGAIN_MAX: usize = 3;
/// A solution that moves a node farther than this is followed by another search, metres.
const MOVED_FAR_M: f64 = 2.0;

impl SyncManager {
    /// Looks for the trajectories that no closure has attached, the longest first, as wholes.
    pub(super) fn attach(&mut self) {
        let known = self.odometry.nodes().len();
        let mut tried = BTreeSet::new();
        while let Some(part) = self.largest_detached(&tried) {
            let nodes = self.odometry.nodes();
            tried.insert(nodes[part.start].trajectory);
            let connectivity = self.connectivity(known);
            let in_map = |node: &Node| connectivity.is_attached(node.trajectory);
            let world = World { nodes, scans: &self.scans, segments: &self.segments, poses: &self.poses };
            let found = AttachmentFinder::default().find(&world, part, in_map, self.finder.scratch());
            if let Some(closure) = found {
                self.closures.push(closure);
                self.is_inlier.push(true);
                self.solve(known, &[]);
            }
        }
    }

    /// Looks for loops in the open again. While driving, windows were as wide as the drift, and what was found first bent the map:
    /// in the windows that the solution leaves fewer places can be mistaken for each other. Where this moves the solution far, other
    /// places have come near, which are looked for then.
    pub(super) fn close_again_in_the_open(&mut self) {
        if !self.odometry.nodes().iter().any(|node| node.is_open) {
            return;
        }
        for _ in 0..AGAIN_MAX {
            let before = self.poses.clone();
            self.find_again_in_the_open();
            let moved_m = before.iter().zip(&self.poses).map(|(a, b)| a.distance_m(b)).fold(0.0, f64::max);
            if moved_m < MOVED_FAR_M {
                break;
            }
        }
    }

    fn find_again_in_the_open(&mut self) {
        let known = self.odometry.nodes().len();
        let (nodes, connections) = (self.odometry.nodes(), self.connections(known));
        let world = World { nodes, scans: &self.scans, segments: &self.segments, poses: &self.poses };
        let marginals = Marginals::new(&self.edges_that_hold(known), &self.poses[..known]);
        let sigmas = |from, to| marginals.as_ref().map(|marginals| marginals.sigmas(from, to));
        let distances_m = |query| graph_distances(nodes, &connections, query);
        let found = self.open_finder.find_again(&world, distances_m, sigmas);
        let again: BTreeSet<usize> = found.iter().map(|closure| closure.edge.to).collect();
        self.closures.retain(|closure| {
            let query = closure.edge.to;
            !nodes[query].is_open || !again.contains(&query)
        });
        self.closures.extend(found);
        self.solve_with(known, &eligible_at_the_end(&self.closures, self.odometry.nodes()), &[]);
    }

    /// The edges of the present solution.
    fn edges_that_hold(&self, known: usize) -> Vec<Edge> {
        let mut edges: Vec<Edge> = self.odometry.edges()[..known - 1].to_vec();
        edges.extend(self.odometry.given());
        let inliers = self.closures.iter().zip(&self.is_inlier).filter(|(_, is_inlier)| **is_inlier);
        edges.extend(inliers.map(|(closure, _)| closure.edge));
        edges.extend(self.joints(known));
        edges
    }

    /// The nodes of the largest trajectory that does not belong to the map, except those tried.
    fn largest_detached(&self, tried: &BTreeSet<u32>) -> Option<Range<usize>> {
        let nodes = self.odometry.nodes();
        let connectivity = self.connectivity(nodes.len());
        let (mut start, mut largest) = (0, 0..0);
        for trajectory in nodes.chunk_by(|a, b| a.trajectory == b.trajectory) {
            let number = trajectory[0].trajectory;
            let is_candidate = !connectivity.is_attached(number) && !tried.contains(&number);
            if is_candidate && trajectory.len() > largest.len() {
                largest = start..start + trajectory.len();
            }
            start += trajectory.len();
        }
        Some(largest).filter(|largest| !largest.is_empty())
    }

    /// The dense pass over all nodes, then the match of all nodes to their common map.
    pub(super) fn refine(&mut self) {
        let nodes = self.odometry.nodes();
        let mut segments = self.segments.clone();
        let rest = segments.last().map_or(0, |s| s.nodes.end)..nodes.len();
        if !rest.is_empty() {
            segments.push(Segment::new(rest));
        }
        let connectivity = self.connectivity(nodes.len());
        let pass = DensePass {
            nodes,
            scans: &self.scans,
            segments: &segments,
            odometry: &self.odometry.matched_edges(),
            constraints: &self.constraints_that_stay(),
            connectivity: &connectivity,
        };
        pass.run(self.finder.scratch(), &mut self.poses);
        self.hold_given();
        self.match_to_map();
    }

    /// What connects nodes in the open, which the passes over all nodes match to nothing: closures that hold, and what odometry or
    /// localisation says between trajectories. And what holds those of an imported map.
    fn constraints_that_stay(&self) -> Vec<Edge> {
        let nodes = self.odometry.nodes();
        let inliers = self.closures.iter().zip(&self.is_inlier).filter(|(_, is_inlier)| **is_inlier);
        inliers
            .map(|(c, _)| c.edge)
            .chain(self.joints(nodes.len()))
            .filter(|edge| nodes[edge.from].is_open || nodes[edge.to].is_open)
            .chain(self.odometry.given())
            .collect()
    }

    /// Matches all nodes of the map to the map that they make together.
    pub(super) fn match_to_map(&mut self) {
        let nodes = self.odometry.nodes();
        let connectivity = self.connectivity(nodes.len());
        let in_map: Vec<bool> = nodes.iter().map(|node| connectivity.is_attached(node.trajectory)).collect();
        let (odometry, constraints) = (&self.odometry.matched_edges(), &self.constraints_that_stay());
        let refinement = Refinement { nodes, scans: &self.scans, odometry, constraints, in_map: &in_map };
        refinement.run(self.finder.scratch(), &mut self.poses);
        self.hold_given();
    }
}
