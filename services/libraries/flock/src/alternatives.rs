//! Other explanations of the relative pose of two robots: looks for places in what the first robot saw where the second robot's scans fit as well.

use super::FlockGraph;
use super::overlap::{Fit, Overlap};
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::segment::{cell_means, cloud, picked};
use flockslam_pose_graph::Edge;
use flockslam_registration::cloud::{Placement, PooledField, Searcher, Window};
use std::f64::consts::PI;
use std::ops::Range;

/// Of a group, those count as one place whose ends lie within this along both ways, metres.
const PLACE_M: f64 = 15.0;
/// Constraints that a pose is verified by.
const RELATIVES_MAX: usize = 64;
/// What the second robot has seen so much before and after these is compared, metres of its way.
const BESIDE_M: f64 = 3.0;
/// What the first robot has seen so much before and after these is looked through for other explanations, metres of its way.
const AROUND_M: f64 = 20.0;
/// A query is a node and so many before and after it.
const QUERY_NODES: usize = 10;
/// Points of a query.
const POINTS: usize = 100;
/// Where other explanations are looked for: as far away as robots see, at any heading.
const WINDOW: Window = Window { reach_m: 14.0, turn_rad: PI };
/// Where the explanation under test is looked for itself.
const HERE: Window = Window { reach_m: 0.4, turn_rad: 0.1 };
/// What is nearer than this is the same explanation.
const APART: Window = Window { reach_m: 0.8, turn_rad: 0.25 };
/// Least score of another explanation, as a share of that of the one under test.
const SCORE_MIN: f64 = 0.75;
/// Squares that a search evaluates before it takes its best result.
const SUMS_MAX: u64 = 120_000;

/// Relative pose that a closure gives for a node of one robot and one of another.
#[derive(Clone, Copy, Debug)]
pub(super) struct RelativePose {
    /// The first robot's node.
    pub from: usize,
    /// The second robot's node.
    pub to: usize,
    /// Pose of `to` seen from `from`.
    pub motion: Placement,
}

impl RelativePose {
    /// The relative pose of a closure.
    pub fn of(closure: &Closure) -> Self {
        let Edge { from, to, motion, .. } = closure.edge;
        Self { from, to, motion }
    }

    /// The same with the other robot as the first.
    pub fn turned(&self) -> Self {
        Self { from: self.to, to: self.from, motion: self.motion.inverse() }
    }
}

/// A place where closures say that two robots have both been.
pub(super) struct Place {
    /// The relative pose in its middle.
    middle: RelativePose,
    /// Ends of the closures around it in the second robot's way, in order, each with what takes the frame of the second's odometry to that of the
    /// first's.
    pub relatives: Vec<(usize, Placement)>,
    /// Nodes of both that it is verified by.
    pub nodes: [Range<usize>; 2],
}

impl Place {
    /// The place around one relative pose of a group.
    pub fn new(graph: &FlockGraph, middle: &RelativePose, group: &[RelativePose]) -> Self {
        let travel_m = |node: usize| graph.nodes[node].drift_bound_m;
        let is_near = |relative: &&RelativePose| {
            let apart_m = |a: usize, b: usize| (travel_m(a) - travel_m(b)).abs();
            apart_m(relative.from, middle.from) <= PLACE_M && apart_m(relative.to, middle.to) <= PLACE_M
        };
        // The first in order, so that what is found later changes little.
        let near: Vec<&RelativePose> = group.iter().filter(is_near).take(RELATIVES_MAX).collect();
        let first_from_second = |relative: &&RelativePose| {
            let (from, to) = (&graph.nodes[relative.from], &graph.nodes[relative.to]);
            (relative.to, from.local_pose.compose(relative.motion).compose(to.local_pose.inverse()))
        };
        let mut relatives: Vec<(usize, Placement)> = near.iter().map(first_from_second).collect();
        relatives.sort_by_key(|(to, _)| *to);
        let stretch = |end: fn(&RelativePose) -> usize, beside_m: f64| {
            let (low, high) = near
                .iter()
                .map(|relative| end(relative))
                .fold((usize::MAX, 0), |(low, high), node| (low.min(node), high.max(node)));
            let (low_m, high_m) = (travel_m(low) - beside_m, travel_m(high) + beside_m);
            // Drift bound jumps where a trajectory or a log ends: none is left.
            let start = graph.nodes[..low].partition_point(|node| node.drift_bound_m < low_m);
            let end = high + graph.nodes[high..].partition_point(|node| node.drift_bound_m <= high_m);
            start..end
        };
        let nodes = [stretch(|relative| relative.from, AROUND_M), stretch(|relative| relative.to, BESIDE_M)];
        Self { middle: *middle, relatives, nodes }
    }

    /// How well what both have seen here fits together as the closures say, and where it fits next best, if anywhere.
    pub fn fits(&self, graph: &FlockGraph) -> (Fit, Option<Fit>) {
        let overlap = self.overlap(graph);
        let other = self.other_place(graph).map(|moved| overlap.fit(&moved));
        (overlap.fit(&Placement::IDENTITY), other)
    }

    /// How well what both have seen here fits together as the closures say.
    pub fn fit(&self, graph: &FlockGraph) -> Fit {
        self.overlap(graph).fit(&Placement::IDENTITY)
    }

    fn overlap<'a>(&self, graph: &'a FlockGraph) -> Overlap<'a> {
        let first = self.nodes[0].clone().map(|node| (node, graph.nodes[node].local_pose));
        let second = self.nodes[1].clone().map(|node| (node, self.placed(graph, node)));
        Overlap::new(graph, first, second)
    }

    /// A node of the second robot in the frame of the first's odometry, by the nearest closure.
    fn placed(&self, graph: &FlockGraph, node: usize) -> Placement {
        let nearest =
            self.relatives.iter().min_by_key(|(to, _)| to.abs_diff(node)).expect("a place has a closure");
        nearest.1.compose(graph.nodes[node].local_pose)
    }

    /// How the surroundings of the middle would have to be moved to be where else they fit best to what the first robot has seen.
    fn other_place(&self, graph: &FlockGraph) -> Option<Placement> {
        let query = self.middle.to;
        let at = self.placed(graph, query);
        let mut points = Vec::new();
        for node in &graph.nodes[self.nodes[0].clone()] {
            let from = at.to(node.local_pose);
            points.extend(graph.scans.points(node.scan).iter().map(|p| from.apply(p.x_m(), p.y_m())));
        }
        let field = PooledField::new(&cell_means(&points));
        let same = |i: &usize| graph.nodes[*i].trajectory == graph.nodes[query].trajectory;
        let start = (query.saturating_sub(QUERY_NODES)..=query).find(same)?;
        let last = (query..(query + QUERY_NODES + 1).min(graph.nodes.len())).rev().find(same)?;
        let points = picked(&cloud(&graph.nodes, &graph.scans, start..last + 1, query), POINTS);
        let mut searcher = Searcher::bounded(SUMS_MAX);
        let mut best = |window, score_min, exclude| {
            searcher.best(&field, &points, Placement::IDENTITY, window, score_min, exclude)
        };
        let here = best(HERE, 0.1, None)?;
        let other = best(WINDOW, SCORE_MIN * here.score, Some((here.placement, APART)))?;
        Some(at.compose(other.placement).compose(at.inverse()))
    }
}
