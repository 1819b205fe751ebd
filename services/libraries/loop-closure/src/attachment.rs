//! Where a trajectory that no closure has attached is in the map: whole stretches of it are compared with whole stretches of the map.
//!
//! A query of [`crate::finder`] sees a few metres, which may be found in many places, so that several must agree. A short trajectory has
//! no several queries. All that it has seen together is found in one place or in none.

use crate::closure::Closure;
use crate::finder::{World, edge, holds, intrusions, nearest_node, self_intrusion};
use crate::node::Node;
use crate::segment::{Segment, cloud, load, packed, picked, unload};
use flockslam_registration::cloud::{
    AlignSettings, Aligner, Found, MomentGrid, Placement, PooledField, Searcher, Window,
};
use std::ops::Range;

/// Travel of a stretch that is looked for, and of one that it is looked for in, metres: over this much odometry does not bend.
const QUERY_M: f64 = 8.0;
const STRETCH_M: f64 = 16.0;
/// A trajectory with less travel has seen too little to be distinguished from others, metres.
const TRAVEL_MIN_M: f64 = 2.0;
/// Most nodes of a stretch.
const NODES_MAX: usize = 64;
/// Stretches of a trajectory that are looked for.
const QUERIES_MAX: usize = 4;
/// Stretches of the map that are looked in, all together: the others of a larger map are left to the search while driving.
const STRETCHES_MAX: usize = 120;
/// Points of a stretch in a search, in the refinement, and at least.
const SEARCH_POINTS: usize = 200;
const REFINE_POINTS: usize = 1500;
const POINTS_MIN: usize = 120;
/// All poses in which both stretches see the same place.
const WINDOW: Window = Window { reach_m: 20.0, turn_rad: std::f64::consts::PI };
/// Squares that a search visits before it gives up.
const SUMS_MAX: u64 = 1_500_000;
/// Least score of a match, and least share of points on the lines of the map after refinement, 0 … 1.
const SCORE_MIN: f64 = 0.75;
const INLIERS_MIN: f64 = 0.75;
/// Score of another place, as a share of the best, at which the match is ambiguous.
const RUNNER_UP: f64 = 0.9;
/// Another place is at least this far away.
const APART: Window = Window { reach_m: 0.6, turn_rad: 0.2 };
/// Largest share of the trajectory's points in space that the map saw free, and the other way round: somebody who stands in the way
/// of the robot hides much.
const INTRUDING_MAX: f64 = 0.22;
const INTRUDED_MAX: f64 = 0.2;

/// Looks for a trajectory in the map.
pub struct AttachmentFinder {
    searcher: Searcher,
    aligner: Aligner,
}

/// A match of a stretch.
struct Candidate {
    target: usize,
    found: Found,
    /// The pose of the stretch's anchor in the solution.
    pose: Placement,
}

impl Default for AttachmentFinder {
    fn default() -> Self {
        let align = AlignSettings { iterations: 12, gate_wide_m: 0.4, ..AlignSettings::default() };
        Self { searcher: Searcher::bounded(SUMS_MAX), aligner: Aligner::new(align) }
    }
}

impl AttachmentFinder {
    /// Looks for the nodes `part`, all of one trajectory, among the nodes `in_map`. `grid` is empty, and is so afterwards.
    pub fn find(
        &mut self,
        world: &World<'_>,
        part: Range<usize>,
        in_map: impl Fn(&Node) -> bool,
        grid: &mut MomentGrid,
    ) -> Option<Closure> {
        let nodes = world.nodes;
        let travel_m = nodes[part.end - 1].travel_m - nodes[part.start].travel_m;
        if travel_m < TRAVEL_MIN_M {
            return None;
        }
        let targets: Vec<Segment> = stretches(nodes, 0..nodes.len(), STRETCH_M)
            .into_iter()
            .filter(|stretch| nodes[stretch.nodes.clone()].iter().all(&in_map))
            .collect();
        if targets.is_empty() || targets.len() > STRETCHES_MAX {
            return None;
        }
        let fields: Vec<PooledField> =
            targets.iter().map(|target| PooledField::new(&target.cloud(nodes, world.scans))).collect();
        // In the open most of what a stretch sees is seen from everywhere.
        let is_closed = |query: &Segment| nodes[query.nodes.clone()].iter().all(|node| !node.is_open);
        let queries: Vec<Segment> = stretches(nodes, part, QUERY_M).into_iter().filter(is_closed).collect();
        let step = queries.len().div_ceil(QUERIES_MAX).max(1);
        queries.iter().step_by(step).find_map(|query| {
            let points = cloud(nodes, world.scans, query.nodes.clone(), query.anchor);
            let best = self.unique(world, &points, &targets, &fields)?;
            self.refined(world, query, &points, &targets[best.target], &best.found, grid)
        })
    }

    /// The best place for these points, if there is no other that is nearly as good.
    fn unique(
        &mut self,
        world: &World<'_>,
        points: &[(f64, f64)],
        targets: &[Segment],
        fields: &[PooledField],
    ) -> Option<Candidate> {
        if points.len() < POINTS_MIN {
            return None;
        }
        let few = picked(points, SEARCH_POINTS);
        let floor = RUNNER_UP * SCORE_MIN;
        let mut best: Option<Candidate> = None;
        let mut others = Vec::new();
        for (target, field) in fields.iter().enumerate() {
            let found = self.searcher.best(field, &few, Placement::IDENTITY, WINDOW, floor, None);
            if self.searcher.gave_up() {
                return None;
            }
            let Some(found) = found else { continue };
            let second_min = (RUNNER_UP * found.score).max(floor);
            let exclude = Some((found.placement, APART));
            let second = self.searcher.best(field, &few, Placement::IDENTITY, WINDOW, second_min, exclude);
            let anchor = world.poses[targets[target].anchor];
            others.extend(second.map(|second| (second.score, anchor.compose(second.placement))));
            let candidate = Candidate { target, pose: anchor.compose(found.placement), found };
            let is_better = best.as_ref().is_none_or(|best| candidate.found.score > best.found.score);
            let worse = if is_better { best.replace(candidate) } else { Some(candidate) };
            others.extend(worse.map(|worse| (worse.found.score, worse.pose)));
        }
        let best = best.filter(|best| best.found.score >= SCORE_MIN)?;
        let alternatives = |(score, pose): &(f64, Placement)| {
            let is_other_place = pose.distance_m(&best.pose) > 2.0 * APART.reach_m
                || pose.turn_rad(&best.pose) > APART.turn_rad;
            *score >= RUNNER_UP * best.found.score && is_other_place
        };
        if others.iter().any(alternatives) { None } else { Some(best) }
    }

    fn refined(
        &mut self,
        world: &World<'_>,
        query: &Segment,
        points: &[(f64, f64)],
        target: &Segment,
        found: &Found,
        grid: &mut MomentGrid,
    ) -> Option<Closure> {
        let (nodes, scans) = (world.nodes, world.scans);
        let anchor = nodes[target.anchor].local_pose;
        let at = |i: usize| anchor.to(nodes[i].local_pose);
        load(grid, nodes, scans, target.nodes.clone(), at);
        let refined = self.aligner.align(grid, &packed(&picked(points, REFINE_POINTS)), found.placement);
        unload(grid, nodes, scans, target.nodes.clone(), at);
        let refined = refined.filter(|refined| holds(refined, found) && refined.inliers >= INLIERS_MIN)?;
        let free_space_agrees = |node: usize| {
            let placement =
                refined.placement.compose(nodes[query.anchor].local_pose.to(nodes[node].local_pose));
            let seen = cloud(nodes, scans, node..node + 1, node);
            let nearest = nearest_node(target, &placement, at);
            let (intruding, intruded) = intrusions(world, node, &seen, target, nearest, &placement, at);
            let usual = self_intrusion(world, node, &seen);
            (intruding - usual, intruded - usual)
        };
        let checked: Vec<(f64, f64)> = query.nodes.clone().step_by(3).map(free_space_agrees).collect();
        let mean = |of: fn(&(f64, f64)) -> f64| checked.iter().map(of).sum::<f64>() / checked.len() as f64;
        if mean(|c| c.0) > INTRUDING_MAX || mean(|c| c.1) > INTRUDED_MAX {
            return None;
        }
        let nearest = nearest_node(target, &refined.placement, at);
        let edge = edge(query.anchor, nearest, &at(nearest), &refined)?;
        Some(Closure { edge, reach_m: 0.0, shift_m: 0.0 })
    }
}

/// Stretches of these nodes of about this travel, each of one trajectory, each starting in the middle of the one before.
fn stretches(nodes: &[Node], range: Range<usize>, travel_m: f64) -> Vec<Segment> {
    let mut stretches: Vec<Segment> = Vec::new();
    let mut start = range.start;
    while start < range.end {
        let belongs = |node: &&Node| {
            node.trajectory == nodes[start].trajectory && node.travel_m - nodes[start].travel_m < travel_m
        };
        let end = start + nodes[start..range.end].iter().take(NODES_MAX).take_while(belongs).count();
        stretches.push(Segment::new(start..end));
        let is_last = end == range.end || nodes[end].trajectory != nodes[start].trajectory;
        start = if is_last { end } else { (start + end).div_ceil(2) };
    }
    stretches
}
