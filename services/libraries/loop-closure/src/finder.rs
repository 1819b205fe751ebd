//! The search for loop closures: takes a query (a node and its neighbours) and segments, matches by branch and bound, refines, checks. Gives closures with
//! their information.

use crate::agreement::WIDE_M;
use crate::closure::Closure;
use crate::fields::{FIELDS_MAX, FieldCache};
use crate::node::{BROKEN_M, Node, POINT_INFORMATION};
use crate::polar::Polar;
use crate::scans::ScanStore;
use crate::segment::{Segment, cloud, load, packed, picked, unload};
use flockslam_pose_graph::Edge;
use flockslam_pose_graph::{in_frame, inflated};
use flockslam_registration::cloud::{
    AlignSettings, Aligner, Alignment, Found, MomentGrid, PackedPoint, Placement, PooledField, Searcher,
    Window,
};

/// A search starts after this much travel, metres.
pub const EVERY_M: f64 = 1.5;
/// Only segments that are at least this much travel back are searched: the node was matched to nearer ones anyway, metres.
pub const LEAST_TRAVEL_M: f64 = 15.0;
/// Most segments tried for one query.
pub const SEGMENTS_PER_QUERY: usize = 6;
/// Least score of a match, 0 … 1.
const SCORE_MIN: f64 = 0.55;
/// Least share of the query's points on the segment's lines after refinement.
const INLIERS_MIN: f64 = 0.6;
/// A query is its node and this many before and after it.
pub const QUERY_NODES: usize = 3;
/// A query of fewer points is not looked for.
const POINTS_MIN: usize = 30;
/// Points of a query in a search.
const SEARCH_POINTS: usize = 150;
/// Points of a query in the refinement.
const REFINE_POINTS: usize = 600;
/// A segment may lie this much farther away than the window and still be searched: both see the same place,
/// metres.
pub const SIGHT_M: f64 = 4.0;
/// The window in a segment without an initial guess: all poses where both see the same place, at any heading.
pub const ANYWHERE: Window = Window { reach_m: 14.0, turn_rad: std::f64::consts::PI };
/// Squares that such a search visits before it returns its best result so far.
const ANYWHERE_SUMS_MAX: u64 = 150_000;
/// Squares that the search for a runner-up visits there before the match counts as ambiguous: it shows that nothing else is as good, which
/// takes longer, and is made for the few segments that match.
const RUNNER_UP_SUMS_MAX: u64 = 3_000_000;
/// Most segments that one query is looked for in so.
const ANYWHERE_MAX: usize = 50;
/// Most segments that a query is looked for in which was found in one of these.
const ELSEWHERE_MAX: usize = 400;
/// The widest window after driving, metres.
const REACH_MAX_M: f64 = 25.0;
/// The first window: a robot that was lost only briefly is near its predicted pose.
const NEARBY: Window = Window { reach_m: 4.0, turn_rad: 0.7 };
/// A runner-up must lie at least this far away from the best match to count.
const APART: Window = Window { reach_m: 0.6, turn_rad: 0.2 };
/// Score of a runner-up, as a share of the best, at which a match is ambiguous.
const RUNNER_UP: f64 = 0.9;
/// In a narrow window a match that moves the robot by no more than this share of it is not compared with others: usual drift is half of it.
const UNCOMPARED_SHARE: f64 = 0.5;
/// Farthest that the refinement may move, metres and radians.
const REFINED_MAX: (f64, f64) = (0.4, 0.15);
/// Largest share of the query's points in space that the segment saw free.
const INTRUDING_MAX: f64 = 0.12;
/// Largest share of the segment's points in space that the query saw free.
const INTRUDED_MAX: f64 = 0.15;
/// Least ratio of the information along the weakest and the strongest direction of translation.
const DEGENERATE: f64 = 0.02;
/// Errors of a closure beyond those of its points: the segment's own bending. Metres and radians, standard deviations.
pub const SLACK: (f64, f64) = (0.04, 0.01);

/// Counts of searches so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SearchCounts {
    /// Branch-and-bound searches.
    pub searches: u64,
    /// Matches with enough score.
    pub matches: u64,
}

/// Looks for loops.
pub struct ClosureFinder {
    fields: FieldCache,
    searcher: Searcher,
    searcher_anywhere: Searcher,
    /// Of runner-ups anywhere.
    searcher_runner_up: Searcher,
    aligner: Aligner,
    grid: MomentGrid,
    counts: SearchCounts,
}

/// The part of the graph that a search needs.
pub struct World<'a> {
    /// The nodes.
    pub nodes: &'a [Node],
    /// Their points.
    pub scans: &'a ScanStore,
    /// The segments so far.
    pub segments: &'a [Segment],
    /// Present poses.
    pub poses: &'a [Placement],
}

impl Default for ClosureFinder {
    fn default() -> Self {
        let align = AlignSettings { iterations: 12, gate_wide_m: 0.4, ..AlignSettings::default() };
        Self {
            fields: FieldCache::new(FIELDS_MAX),
            searcher: Searcher::default(),
            searcher_anywhere: Searcher::bounded(ANYWHERE_SUMS_MAX),
            searcher_runner_up: Searcher::bounded(RUNNER_UP_SUMS_MAX),
            aligner: Aligner::new(align),
            grid: MomentGrid::default(),
            counts: SearchCounts::default(),
        }
    }
}

impl ClosureFinder {
    /// A finder that evaluates at most so many squares in a global search before it gives up, and that keeps so many segments ready.
    pub fn thorough(sums_max: u64, fields: usize) -> Self {
        let [searcher_anywhere, searcher_runner_up] = [0; 2].map(|_| Searcher::bounded(sums_max));
        Self { searcher_anywhere, searcher_runner_up, fields: FieldCache::new(fields), ..Self::default() }
    }

    /// An empty grid to work with, lent between searches: it must be given back empty.
    pub fn scratch(&mut self) -> &mut MomentGrid {
        &mut self.grid
    }

    /// Counts of searches so far.
    pub fn counts(&self) -> SearchCounts {
        self.counts
    }

    /// Looks for the surroundings of node `query` in older segments; `distances_m` are its distances along
    /// the graph to all nodes, or to those [`in_reach`] where there is one trajectory.
    pub fn find(&mut self, world: &World<'_>, query: usize, distances_m: &[f64]) -> Vec<Closure> {
        let [candidates, rest] = self.candidates(world, query, distances_m);
        let mut found = self.find_in(world, query, QUERY_NODES, &candidates);
        // Where else a query is found that was found anywhere contradicts it.
        if found.iter().any(|closure| closure.reach_m == ANYWHERE.reach_m) {
            found.extend(self.find_in(world, query, QUERY_NODES, &rest));
        }
        found
    }

    /// Looks for the surroundings of node `query`, so many nodes before and after it, in these segments.
    pub fn find_in(
        &mut self,
        world: &World<'_>,
        query: usize,
        reach: usize,
        candidates: &[(usize, Window)],
    ) -> Vec<Closure> {
        let points = cloud(world.nodes, world.scans, surroundings(world.nodes, query, reach), query);
        if points.len() < POINTS_MIN {
            return Vec::new();
        }
        candidates
            .iter()
            .filter_map(|(segment, window)| self.try_segment(world, query, &points, *segment, *window))
            .collect()
    }

    /// The segments that the query may see, nearest first, with the search window in each; and those beyond that it is looked for in when it
    /// is found anywhere.
    fn candidates(&self, world: &World<'_>, query: usize, distances_m: &[f64]) -> [Vec<(usize, Window)>; 2] {
        let mut near = Vec::new();
        for (number, segment) in world.segments.iter().enumerate().filter(|(_, s)| is_old(world, s, query)) {
            if distances_m[segment.anchor] >= BROKEN_M {
                continue;
            }
            let window = window(distances_m[segment.anchor]);
            let apart_m = apart_m(world, segment, query);
            if apart_m <= window.reach_m + SIGHT_M {
                near.push((apart_m, number, window));
            }
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(SEGMENTS_PER_QUERY);
        let mut candidates: Vec<_> = near.into_iter().map(|(_, number, window)| (number, window)).collect();
        let [first, rest] = self.anywhere(world, query, distances_m);
        candidates.extend(first);
        [candidates, rest]
    }

    /// Segments that only closures could connect with the query, each to be searched all over. The next query begins with
    /// those that this one has no budget for: the second list.
    fn anywhere(&self, world: &World<'_>, query: usize, distances_m: &[f64]) -> [Vec<(usize, Window)>; 2] {
        let trajectory = world.nodes[query].trajectory;
        let broken =
            |s: &Segment| distances_m[s.anchor] >= BROKEN_M && world.nodes[s.anchor].trajectory != trajectory;
        let mut far: Vec<usize> =
            (0..world.segments.len()).filter(|&number| broken(&world.segments[number])).collect();
        let mut near: Vec<(f64, usize)> = Vec::new();
        for &number in &far {
            let apart_m = apart_m(world, &world.segments[number], query);
            if apart_m <= NEARBY.reach_m + SIGHT_M {
                near.push((apart_m, number));
            }
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(SEGMENTS_PER_QUERY);
        if !far.is_empty() {
            let first = (self.counts.searches % far.len() as u64) as usize;
            far.rotate_left(first);
        }
        far.truncate(ELSEWHERE_MAX);
        let rest = far.split_off(far.len().min(ANYWHERE_MAX));
        let near = near.into_iter().map(|(_, number)| (number, NEARBY));
        let anywhere = |number: usize| (number, ANYWHERE);
        [near.chain(far.into_iter().map(anywhere)).collect(), rest.into_iter().map(anywhere).collect()]
    }

    fn try_segment(
        &mut self,
        world: &World<'_>,
        query: usize,
        points: &[(f64, f64)],
        number: usize,
        window: Window,
    ) -> Option<Closure> {
        let segment = &world.segments[number];
        let guess = if window == ANYWHERE {
            Placement::IDENTITY
        } else {
            world.poses[segment.anchor].to(world.poses[query])
        };
        let few = picked(points, if window == ANYWHERE { SEARCH_POINTS / 2 } else { SEARCH_POINTS });
        let found = self.search(world, &few, number, guess, window)?;
        let (nodes, scans) = (world.nodes, world.scans);
        let anchor = nodes[segment.anchor].local_pose;
        let at = |i: usize| anchor.to(nodes[i].local_pose);
        load(&mut self.grid, nodes, scans, segment.nodes.clone(), at);
        let refined =
            self.aligner.align(&mut self.grid, &packed(&picked(points, REFINE_POINTS)), found.placement);
        unload(&mut self.grid, nodes, scans, segment.nodes.clone(), at);
        let refined = refined.filter(|refined| holds(refined, &found))?;
        let nearest = nearest_node(segment, &refined.placement, at);
        let (intruding, intruded) =
            intrusions(world, query, points, segment, nearest, &refined.placement, at);
        let usual = self_intrusion(world, query, points);
        let free_space_agrees = intruding <= INTRUDING_MAX + usual && intruded <= INTRUDED_MAX + usual;
        // The search for a runner-up comes last: a match that is rejected otherwise needs none.
        if !free_space_agrees || self.is_ambiguous(world, &few, number, guess, window, &found) {
            return None;
        }
        let edge = edge(query, nearest, &at(nearest), &refined)?;
        let shift_m = if window == ANYWHERE { 0.0 } else { refined.placement.distance_m(&guess) };
        Some(Closure { edge, reach_m: window.reach_m, shift_m })
    }

    fn search(
        &mut self,
        world: &World<'_>,
        few: &[(f64, f64)],
        number: usize,
        guess: Placement,
        window: Window,
    ) -> Option<Found> {
        let searcher = if window == ANYWHERE { &mut self.searcher_anywhere } else { &mut self.searcher };
        let field = field(&mut self.fields, world, number);
        self.counts.searches += 1;
        let found = searcher.best(field, few, guess, window, SCORE_MIN, None)?;
        self.counts.matches += 1;
        Some(found)
    }

    /// Whether another place in the window fits nearly as well as the one found, or may do so. In a narrow window only a match that would
    /// move the robot far is in question: along the racks of an aisle the next bay fits as well as the true one.
    fn is_ambiguous(
        &mut self,
        world: &World<'_>,
        few: &[(f64, f64)],
        number: usize,
        guess: Placement,
        window: Window,
        found: &Found,
    ) -> bool {
        let is_expected = found.placement.distance_m(&guess) <= UNCOMPARED_SHARE * window.reach_m;
        if window.reach_m <= WIDE_M && is_expected {
            return false;
        }
        let searcher = if window == ANYWHERE { &mut self.searcher_runner_up } else { &mut self.searcher };
        let field = field(&mut self.fields, world, number);
        let exclude = Some((found.placement, APART));
        let second = searcher.best(field, few, guess, window, RUNNER_UP * found.score, exclude);
        second.is_some() || searcher.gave_up()
    }
}

/// The field of a segment, from the cache where it is.
fn field<'a>(fields: &'a mut FieldCache, world: &World<'_>, number: usize) -> &'a PooledField {
    let segment = &world.segments[number];
    let make = || PooledField::new(&segment.cloud(world.nodes, world.scans));
    fields.get(world.nodes[segment.anchor].sequence, make)
}

/// Whether a segment is so far back that a query is looked for in it.
fn is_old(world: &World<'_>, segment: &Segment, query: usize) -> bool {
    world.nodes[query].travel_m - world.nodes[segment.nodes.end - 1].travel_m >= LEAST_TRAVEL_M
}

/// The anchors of the old segments that lie within the widest window around a query: distances to others do not matter to a search.
pub fn in_reach(world: &World<'_>, query: usize) -> Vec<usize> {
    let old = world.segments.iter().filter(|segment| is_old(world, segment, query));
    old.filter(|segment| apart_m(world, segment, query) <= REACH_MAX_M + SIGHT_M).map(|s| s.anchor).collect()
}

/// Whether a refined match is good enough by itself.
pub(crate) fn holds(refined: &Alignment, found: &Found) -> bool {
    let [xx, xy, _, yy, ..] = refined.information;
    let (middle, gap) = (0.5 * (xx + yy), (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt());
    refined.inliers >= INLIERS_MIN
        && refined.placement.distance_m(&found.placement) <= REFINED_MAX.0
        && refined.placement.turn_rad(&found.placement) <= REFINED_MAX.1
        && middle - gap >= DEGENERATE * (middle + gap)
}

/// A query's node and its neighbours on the trajectory, so many before and after it.
fn surroundings(nodes: &[Node], query: usize, reach: usize) -> std::ops::Range<usize> {
    let same = |i: &usize| nodes[*i].trajectory == nodes[query].trajectory;
    let start = (query.saturating_sub(reach)..=query).find(same).unwrap_or(query);
    let last = (query..(query + reach + 1).min(nodes.len())).rev().find(same).unwrap_or(query);
    start..last + 1
}

/// From a query to the nearest node of a segment, metres.
pub fn apart_m(world: &World<'_>, segment: &Segment, query: usize) -> f64 {
    let at = world.poses[query];
    segment.nodes.clone().map(|i| world.poses[i].distance_m(&at)).fold(f64::INFINITY, f64::min)
}

/// The search window after `distance_m` along the graph.
pub fn window(distance_m: f64) -> Window {
    Window {
        reach_m: (0.3 + 0.06 * distance_m).min(REACH_MAX_M),
        turn_rad: (0.06 + 0.002 * distance_m).min(0.7),
    }
}

pub(crate) fn nearest_node(segment: &Segment, to: &Placement, at: impl Fn(usize) -> Placement) -> usize {
    let nodes = segment.nodes.clone();
    nodes.min_by(|&a, &b| at(a).distance_m(to).total_cmp(&at(b).distance_m(to))).expect("a segment has nodes")
}

/// Shares of the points of either side that lie in space that the other saw free: the query's at most, and the segment's.
pub(crate) fn intrusions(
    world: &World<'_>,
    query: usize,
    points: &[(f64, f64)],
    segment: &Segment,
    nearest: usize,
    placement: &Placement,
    at: impl Fn(usize) -> Placement,
) -> (f64, f64) {
    let scan_of = |i: usize| world.scans.points(world.nodes[i].scan);
    let around = nearest.saturating_sub(3).max(segment.nodes.start)..(nearest + 4).min(segment.nodes.end);
    let placed: Vec<(f64, f64)> = points.iter().map(|&(x, y)| placement.apply(x, y)).collect();
    let seen_by = |node: usize| intruding(&Polar::new(scan_of(node)), &at(node), placed.iter().copied());
    let most = around.step_by(3).map(seen_by).fold(0.0, f64::max);
    let own = at(nearest);
    let theirs = scan_of(nearest).iter().map(|p: &PackedPoint| own.apply(p.x_m(), p.y_m()));
    (most, intruding(&Polar::new(scan_of(query)), placement, theirs))
}

/// Share of the points of a query's surroundings in space that its own scans saw free: what plants and people do between one
/// scan and the next.
pub(crate) fn self_intrusion(world: &World<'_>, query: usize, points: &[(f64, f64)]) -> f64 {
    let around = surroundings(world.nodes, query, QUERY_NODES);
    let ends = [around.start, around.end - 1];
    let share = |i: usize| {
        let at = world.nodes[query].local_pose.to(world.nodes[i].local_pose);
        intruding(&Polar::new(world.scans.points(world.nodes[i].scan)), &at, points.iter().copied())
    };
    0.5 * (share(ends[0]) + share(ends[1]))
}

/// Share of the points in space that a scan saw free, of those that it observed at all.
fn intruding(polar: &Polar, at: &Placement, points: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (mut looked, mut through) = (0u32, 0u32);
    for (x, y) in points {
        if let Some(free) = polar.looked_through(at, x, y) {
            looked += 1;
            through += u32::from(free);
        }
    }
    f64::from(through) / f64::from(looked.max(1))
}

pub(crate) fn edge(query: usize, nearest: usize, at: &Placement, refined: &Alignment) -> Option<Edge> {
    let information = inflated(&refined.information.map(|v| v * POINT_INFORMATION), SLACK.0, SLACK.1)?;
    let motion = at.to(refined.placement);
    Some(Edge { from: nearest, to: query, motion, information: in_frame(&information, at) })
}
