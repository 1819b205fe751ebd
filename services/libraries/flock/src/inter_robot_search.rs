//! The search for places that a robot shares with others: matches its queries to other robots' segments, first anywhere, then where the ties found
//! so far say. Gives constraints.

use super::FlockGraph;
use super::flock_solution::Solved;
use super::inspection::Inspected;
use super::similarity::Similarity;
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::connectivity::TrajectoryConnectivity;
use flockslam_loop_closure::finder::{ANYWHERE, ClosureFinder, QUERY_NODES, SIGHT_M, World, apart_m, window};
use flockslam_loop_closure::finder::{EVERY_M, SEGMENTS_PER_QUERY};
use flockslam_loop_closure::node::{BROKEN_M, Node};
use flockslam_records::{Constraint, RobotId};
use flockslam_registration::cloud::{Placement, Window};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Of the queries, every so many are looked for anywhere.
const WIDE_EVERY: usize = 2;
/// Squares that a global search evaluates before it gives up.
const WIDE_SUMS_MAX: u64 = 250_000;
/// So many queries before and after one that connected two robots are searched near the pose that it predicts.
const NEIGHBOURS: usize = 3;
/// What a match would have along so much of both ways before and after it is looked for, metres, each query in so many segments.
const FOLLOWED_M: f64 = 10.0;
const FOLLOWED_IN: usize = 2;
/// Closures between two logs that are inliers from which it counts as known how they lie to each other. Until then alternative explanations are looked for.
const FIRM: usize = 6;
/// Segments kept ready for matching.
const FIELDS: usize = 160;

/// A query and a segment to be compared anywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Pair {
    /// How different their surroundings are.
    apart: u32,
    /// Place of the query among those that are looked for anywhere.
    place: usize,
    segment: usize,
}

/// Looks for the places that a robot shares with others.
pub struct Search {
    finder: ClosureFinder,
    /// Pairs of query and segment that have been compared anywhere, or near where they are expected: (query, segment, anywhere).
    tried: BTreeSet<(u64, u64, bool)>,
    /// The same of those that were looked for where a match would have them: query, segment, and about where, in metres and half radians.
    followed: BTreeSet<(u64, u64, [i32; 3])>,
    /// What has been found in this run.
    found: Vec<Constraint>,
}

impl Search {
    pub fn new() -> Self {
        Self {
            finder: ClosureFinder::thorough(WIDE_SUMS_MAX, FIELDS),
            tried: BTreeSet::new(),
            followed: BTreeSet::new(),
            found: Vec::new(),
        }
    }

    /// Searches so far.
    pub fn searches(&self) -> u64 {
        self.finder.counts().searches
    }

    /// Looks for the nodes of `own` in the segments of other robots, with at most about so many searches: first anywhere, until
    /// enough closures agree on the relative pose of the robots, then near the predicted pose. Gives what was found, which is in the graph
    /// as well.
    pub fn run(
        &mut self,
        graph: &mut FlockGraph,
        own: &RobotId,
        searches_max: u64,
        inspected: &mut Inspected,
    ) -> Vec<Constraint> {
        if graph.is_empty() {
            return Vec::new();
        }
        let until = self.searches().saturating_add(searches_max);
        let queries = queries(graph, own, EVERY_M);
        let few: Vec<usize> = queries.iter().copied().step_by(WIDE_EVERY).collect();
        let mut solved = graph.solve(inspected);
        self.anywhere(graph, &few, until, &mut solved, inspected);
        for query in queries {
            if self.searches() >= until {
                break;
            }
            self.near(graph, query, &solved);
        }
        std::mem::take(&mut self.found)
    }

    /// Looks for a query where the solution puts it.
    fn near(&mut self, graph: &mut FlockGraph, query: usize, solved: &Solved) {
        let most = SEGMENTS_PER_QUERY;
        let name = |node: usize| graph.nodes[node].sequence;
        let is_tried =
            |k: &usize| self.tried.contains(&(name(query), name(graph.segments[*k].anchor), false));
        // Distances along the graph take a while.
        if nearby(graph, solved, query, None, most).iter().all(is_tried) {
            return;
        }
        let distances_m = graph.distances_m(solved, query);
        let near = nearby(graph, solved, query, Some(&distances_m), most);
        let candidates: Vec<(usize, Window)> = near
            .into_iter()
            .filter(|number| self.is_new(graph, query, *number, false))
            .map(|number| (number, window(distances_m[graph.segments[number].anchor])))
            .collect();
        self.search(graph, &solved.poses, query, &candidates);
    }

    /// Looks for queries in all that nothing is known of, the most similar first, until it is known; the solution is kept up.
    fn anywhere(
        &mut self,
        graph: &mut FlockGraph,
        queries: &[usize],
        until: u64,
        solved: &mut Solved,
        inspected: &mut Inspected,
    ) {
        let mut known = firmly_connected(graph, solved);
        let mut order: VecDeque<Pair> = self.most_similar(graph, queries, &known).into();
        while let Some(Pair { place, segment, .. }) = order.pop_front() {
            let query = queries[place];
            if self.searches() >= until {
                return;
            }
            if !is_strange(graph, &known, query, segment) || !self.is_new(graph, query, segment, true) {
                continue;
            }
            let matches = self.search(graph, &solved.poses, query, &[(segment, ANYWHERE)]);
            if matches.is_empty() {
                continue;
            }
            matches.iter().for_each(|closure| self.follow(graph, closure, queries));
            *solved = graph.solve(inspected);
            if !is_strange(graph, &solved.connectivity, query, segment) {
                // Connected, if weakly: closures that confirm it or not are near the predicted pose.
                let neighbours =
                    place.saturating_sub(NEIGHBOURS)..(place + NEIGHBOURS + 1).min(queries.len());
                neighbours.for_each(|place| self.near(graph, queries[place], solved));
                *solved = graph.solve(inspected);
            }
            known = firmly_connected(graph, solved);
        }
    }

    /// All pairs of a query and a segment of which it is not known how they lie to each other, the most similar first.
    fn most_similar(
        &self,
        graph: &FlockGraph,
        queries: &[usize],
        known: &TrajectoryConnectivity,
    ) -> Vec<Pair> {
        let similarity = Similarity::new(graph);
        let mut pairs = Vec::new();
        for (place, &query) in queries.iter().enumerate() {
            let strange = (0..graph.segments.len()).filter(|k| is_strange(graph, known, query, *k));
            pairs.extend(strange.map(|segment| {
                let apart = similarity.distance(query, &graph.segments[segment]);
                Pair { apart, place, segment }
            }));
        }
        pairs.sort_unstable();
        pairs
    }

    /// Whether a query and a segment have not been compared like this yet; from now on they have.
    fn is_new(&mut self, graph: &FlockGraph, query: usize, segment: usize, anywhere: bool) -> bool {
        let name = |node: usize| graph.nodes[node].sequence;
        self.tried.insert((name(query), name(graph.segments[segment].anchor), anywhere))
    }

    fn search(
        &mut self,
        graph: &mut FlockGraph,
        poses: &[Placement],
        query: usize,
        candidates: &[(usize, Window)],
    ) -> Vec<Closure> {
        let world = World { nodes: &graph.nodes, scans: &graph.scans, segments: &graph.segments, poses };
        let closures = self.finder.find_in(&world, query, QUERY_NODES, candidates);
        for closure in &closures {
            let constraint = constraint(graph, closure);
            graph.add_across(&constraint);
            self.found.push(constraint);
        }
        closures
    }

    /// Looks for what else would have to match if a match that was found anywhere is right: near it, along both ways.
    fn follow(&mut self, graph: &mut FlockGraph, closure: &Closure, queries: &[usize]) {
        let (from, to) = (closure.edge.from, closure.edge.to);
        let nodes = &graph.nodes;
        let along_m = |a: usize, b: usize| (nodes[a].drift_bound_m - nodes[b].drift_bound_m).abs();
        let moved =
            nodes[from].local_pose.compose(closure.edge.motion).compose(nodes[to].local_pose.inverse());
        let place = |node: &Node| {
            if node.trajectory == nodes[to].trajectory {
                moved.compose(node.local_pose)
            } else {
                node.local_pose
            }
        };
        let poses: Vec<Placement> = nodes.iter().map(place).collect();
        let mut candidates: Vec<(usize, usize, Window)> = Vec::new();
        for &query in queries.iter().filter(|query| along_m(**query, to) <= FOLLOWED_M) {
            let world = World { nodes, scans: &graph.scans, segments: &graph.segments, poses: &poses };
            let mut near: Vec<(f64, usize)> = (0..graph.segments.len())
                .filter(|k| along_m(graph.segments[*k].anchor, from) <= FOLLOWED_M)
                .map(|k| (apart_m(&world, &graph.segments[k], query), k))
                .filter(|(apart_m, _)| *apart_m <= SIGHT_M)
                .collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            let window_of = |k: usize| window(along_m(query, to) + along_m(graph.segments[k].anchor, from));
            candidates.extend(near.iter().take(FOLLOWED_IN).map(|(_, k)| (query, *k, window_of(*k))));
        }
        for (query, segment, window) in candidates {
            let guess = poses[graph.segments[segment].anchor].to(poses[query]);
            if self.is_new_there(graph, query, segment, &guess) {
                self.search(graph, &poses, query, &[(segment, window)]);
            }
        }
    }

    /// Whether a query has not been looked for in this part of a segment yet; from now on it has.
    fn is_new_there(&mut self, graph: &FlockGraph, query: usize, segment: usize, guess: &Placement) -> bool {
        let name = |node: usize| graph.nodes[node].sequence;
        let part = [guess.x_m, guess.y_m, 2.0 * guess.heading_rad].map(|value| value.round() as i32);
        self.followed.insert((name(query), name(graph.segments[segment].anchor), part))
    }
}

/// Which trajectories are connected to each other by enough inlier closures.
fn firmly_connected(graph: &FlockGraph, solved: &Solved) -> TrajectoryConnectivity {
    let logs = |i: usize| {
        let edge = &graph.closures[i].edge;
        let (a, b) = (graph.owner(edge.from), graph.owner(edge.to));
        (a.min(b), a.max(b))
    };
    let mut ties: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    let inliers: Vec<usize> = (0..graph.closures.len()).filter(|i| solved.is_inlier[*i]).collect();
    inliers.iter().for_each(|i| *ties.entry(logs(*i)).or_default() += 1);
    let firm = |i: &usize| !graph.is_across(&graph.closures[*i]) || ties[&logs(*i)] >= FIRM;
    let firm: Vec<bool> = (0..graph.closures.len()).map(|i| solved.is_inlier[i] && firm(&i)).collect();
    graph.connectivity(&firm)
}

/// Whether a segment is another robot's and its pose relative to the query is not known.
fn is_strange(graph: &FlockGraph, known: &TrajectoryConnectivity, query: usize, segment: usize) -> bool {
    let anchor = graph.segments[segment].anchor;
    let part = |node: usize| known.part(graph.nodes[node].trajectory);
    graph.owner(anchor) != graph.owner(query) && part(anchor) != part(query)
}

/// Nodes of a robot at which a search is due, `every_m` metres of its way apart, away from the ends of its trajectories.
fn queries(graph: &FlockGraph, own: &RobotId, every_m: f64) -> Vec<usize> {
    let mut queries = Vec::new();
    for log in graph.logs.iter().filter(|log| log.robot == *own) {
        let mut next_m = f64::NEG_INFINITY;
        for i in log.nodes.clone().skip(QUERY_NODES) {
            if graph.nodes[i].travel_m >= next_m && i + QUERY_NODES < log.nodes.end {
                queries.push(i);
                next_m = graph.nodes[i].travel_m + every_m;
            }
        }
    }
    queries
}

/// Segments of other robots that the query may see, nearest first; without distances along the graph, as if they were well known.
fn nearby(
    graph: &FlockGraph,
    solved: &Solved,
    query: usize,
    distances_m: Option<&[f64]>,
    most: usize,
) -> Vec<usize> {
    let world =
        World { nodes: &graph.nodes, scans: &graph.scans, segments: &graph.segments, poses: &solved.poses };
    let part = |node: usize| solved.connectivity.part(graph.nodes[node].trajectory);
    let mut near = Vec::new();
    for (number, segment) in graph.segments.iter().enumerate() {
        let distance_m = distances_m.map_or(0.0, |distances_m| distances_m[segment.anchor]);
        let is_anothers = graph.owner(segment.anchor) != graph.owner(query);
        if !is_anothers || part(segment.anchor) != part(query) || distance_m >= BROKEN_M {
            continue;
        }
        let apart_m = apart_m(&world, segment, query);
        if apart_m <= window(distance_m).reach_m + SIGHT_M {
            near.push((apart_m, number));
        }
    }
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.into_iter().take(most).map(|(_, number)| number).collect()
}

/// A closure as it is published.
fn constraint(graph: &FlockGraph, closure: &Closure) -> Constraint {
    Constraint {
        from: graph.name(closure.edge.from),
        to: graph.name(closure.edge.to),
        motion: closure.edge.motion.pose(),
        information: closure.edge.information.map(|v| v as f32),
        reach_m: closure.reach_m as f32,
        shift_m: closure.shift_m as f32,
    }
}
