//! The search for loop closures in the open, where surfaces are far apart: takes a query and older nodes, matches the points of some metres
//! of travel to the surfaces of an older stretch. Gives closures with their information.

use crate::closure::Closure;
use crate::finder::{SearchCounts, World, window};
use crate::node::BROKEN_M;
use flockslam_geometry::elementary::{hypot, sin};
use flockslam_geometry::{Point, Pose};
use flockslam_pose_graph::{Edge, Symmetric, inflated, inverse};
use flockslam_registration::cloud::{Placement, Window};
use flockslam_registration::{SurfaceCounts, SurfaceFit, SurfaceMap, SurfacePrior};
use nalgebra::{Matrix3, Vector3};
use std::ops::{Range, RangeInclusive};

/// A query is the nodes over this much travel up to its node, metres, and few after it.
const QUERY_M: f64 = 6.0;
const QUERY_AFTER: usize = 3;
/// Points of a query.
const QUERY_POINTS: usize = 500;
/// A query of fewer points is not looked for.
const POINTS_MIN: usize = 60;
/// A search starts after this much travel, metres.
const EVERY_M: f64 = 3.0;
/// Only what is at least this much travel back is searched, metres: nearer surfaces held the front end.
const LEAST_TRAVEL_M: f64 = 60.0;
/// Travel before and after the nearest older node whose points are matched to, metres.
const STRETCH_M: f64 = 20.0;
/// Nodes of such a stretch at most.
const STRETCH_NODES: usize = 300;
/// An older node may lie this much farther away than the window and still see the same surfaces, metres.
const SIGHT_M: f64 = 8.0;
/// Stretches that are searched for one query.
const STRETCHES: usize = 2;
/// Poses of a coarse search: at most so many along each axis of the position, and of the heading.
const COARSE: (i32, i32) = (16, 10);
/// Points of a query in the coarse search, and points in a cell from which on it is a full surface.
const COARSE_POINTS: usize = 120;
const FULL_CELL: u8 = 6;
/// Poses of the coarse search that are refined, and how far apart they lie, metres and radians.
const STARTS: usize = 6;
const APART: (f64, f64) = (1.0, 0.06);
/// How far a refinement may move a start, standard deviations in metres and radians.
const START_SIGMA: (f64, f64) = (1.0, 0.06);
/// Least share of inliers; with 0.5 one of eight drives over the simulated campus is bent by 0.8 m.
const INLIERS_MIN: f64 = 0.6;
/// So much less is enough where the robot looks back: it sees the other sides of what stands there, and at the true pose some 40 to 60 %
/// of a query lie on the older surfaces.
const OTHER_SIDE_INLIERS: f64 = 0.18;
/// A pose elsewhere that explains the query nearly as well makes the match ambiguous: difference of costs per point.
const AMBIGUOUS_PER_POINT: f64 = 0.04;
/// Greatest standard deviations of a match, metres and radians.
const SIGMA_MAX: (f64, f64) = (0.15, 0.015);
/// Errors of a closure beyond those of its points: both stretches bend. Metres and radians, standard deviations.
pub const SLACK: (f64, f64) = (0.1, 0.005);
/// The same beyond these where the robot looks back: it sees the other sides of what stands there.
const OTHER_SIDE: (f64, f64) = (0.4, 0.015);
/// A match may lie so far outside its window, metres and radians.
const OUTSIDE: (f64, f64) = (0.2, 0.02);
/// At the end windows are so many standard deviations of the solution wide, but no narrower than this, metres. With four, one
/// of 18 campuses was off by 0.64 m, with eight by 0.20 m.
const SIGMAS: f64 = 8.0;
const NARROW_M: f64 = 2.0;
/// After failures in a row only every n-th search is made, n up to this.
const FAILURES_MAX: u32 = 4;

/// Looks for loops in the open.
#[derive(Default)]
pub struct OpenFinder {
    map: SurfaceMap,
    counts: SurfaceCounts,
    points: Vec<Point>,
    next_m: f64,
    failures: u32,
    searches: u64,
    matches: u64,
}

impl OpenFinder {
    /// Counts of searches so far.
    pub fn counts(&self) -> SearchCounts {
        SearchCounts { searches: self.searches, matches: self.matches }
    }

    /// Looks for the surroundings of node `query` among older nodes; `distances_m` are its distances along the graph to all nodes.
    pub fn find(&mut self, world: &World<'_>, query: usize, distances_m: &[f64]) -> Vec<Closure> {
        let travel_m = world.nodes[query].travel_m;
        if travel_m < self.next_m {
            return Vec::new();
        }
        let found = self.look(world, query, distances_m, |_, window| window);
        let Some(found) = found else { return Vec::new() };
        // What was not found is hardly found a step farther.
        self.failures = if found.is_empty() { (self.failures + 1).min(FAILURES_MAX) } else { 0 };
        self.next_m = travel_m + EVERY_M * f64::from(self.failures.max(1));
        found
    }

    /// Looks for the surroundings of node `query` wherever older nodes are near; `None` where there are none.
    fn look(
        &mut self,
        world: &World<'_>,
        query: usize,
        distances_m: &[f64],
        narrowed: impl Fn(usize, Window) -> Window,
    ) -> Option<Vec<Closure>> {
        let stretches = stretches(world, query, distances_m);
        if stretches.is_empty() {
            return None;
        }
        let searched = stretches
            .into_iter()
            .filter_map(|(nearest, window)| self.search(world, query, nearest, narrowed(nearest, window)));
        Some(searched.collect())
    }

    /// Looks again for the surroundings of open nodes, one every few metres, among those before them, in the windows that a solution
    /// leaves: `distances_m` gives distances along its graph from a node, `sigmas` how uncertain it is about the pose of the second node in the
    /// axes of the first, metres and radians.
    pub fn find_again(
        &mut self,
        world: &World<'_>,
        distances_m: impl Fn(usize) -> Vec<f64>,
        sigmas: impl Fn(usize, usize) -> Option<[f64; 3]>,
    ) -> Vec<Closure> {
        let (mut found, mut next_m) = (Vec::new(), 0.0);
        for (query, node) in world.nodes.iter().enumerate() {
            if node.is_open && node.travel_m >= next_m {
                let narrowed = |nearest, window: Window| {
                    let sigmas = (window.reach_m > NARROW_M).then(|| sigmas(nearest, query)).flatten();
                    sigmas.map_or(window, |sigmas| narrowed(window, sigmas))
                };
                found.extend(self.look(world, query, &distances_m(query), narrowed).unwrap_or_default());
                next_m = node.travel_m + EVERY_M;
            }
        }
        found
    }

    /// Matches a query to the stretch around an older node.
    fn search(&mut self, world: &World<'_>, query: usize, nearest: usize, window: Window) -> Option<Closure> {
        self.searches += 1;
        let own = own_range(world, query);
        self.collect(world, own, query);
        if self.points.len() < POINTS_MIN {
            return None;
        }
        self.load(world, nearest);
        let guess = world.poses[nearest].to(world.poses[query]);
        let found = self.best(guess, window);
        self.map.clear();
        let fit = found.filter(|fit| is_within(window, guess.pose(), fit.pose))?;
        self.matches += 1;
        let at = Placement::from(fit.pose);
        Some(Closure {
            edge: Edge { from: nearest, to: query, motion: at, information: information(&fit)? },
            reach_m: window.reach_m,
            shift_m: at.distance_m(&guess),
        })
    }

    /// The points of the query's nodes, in its frame.
    fn collect(&mut self, world: &World<'_>, range: Range<usize>, query: usize) {
        self.points.clear();
        let count: usize = range.clone().map(|i| world.scans.points(world.nodes[i].scan).len()).sum();
        let stride = count.div_ceil(QUERY_POINTS).max(1);
        let mut number = 0;
        for i in range {
            let at = world.nodes[query].local_pose.to(world.nodes[i].local_pose);
            for point in world.scans.points(world.nodes[i].scan) {
                if number % stride == 0 {
                    let (x_m, y_m) = at.apply(point.x_m(), point.y_m());
                    self.points.push(Point::new(x_m, y_m));
                }
                number += 1;
            }
        }
    }

    /// Fills the map with the stretch around a node, in its frame.
    fn load(&mut self, world: &World<'_>, nearest: usize) {
        let nodes = world.nodes;
        let middle = &nodes[nearest];
        let in_stretch = |i: &usize| {
            nodes[*i].trajectory == middle.trajectory
                && (nodes[*i].travel_m - middle.travel_m).abs() <= STRETCH_M
        };
        let half = STRETCH_NODES / 2;
        let first = (nearest.saturating_sub(half)..=nearest).find(in_stretch).unwrap_or(nearest);
        let end = (nearest..nodes.len().min(nearest + half)).take_while(in_stretch).last().unwrap_or(nearest);
        let mut points = Vec::new();
        for node in &nodes[first..=end] {
            points.clear();
            points.extend(world.scans.points(node.scan).iter().map(|p| Point::new(p.x_m(), p.y_m())));
            self.map.add(middle.local_pose.to(node.local_pose).pose(), &points);
        }
    }

    /// The pose of the query that explains it best and is not ambiguous.
    fn best(&mut self, guess: Placement, window: Window) -> Option<SurfaceFit> {
        let mut fits: Vec<SurfaceFit> = Vec::new();
        for start in self.starts(guess, window) {
            let sigma = Vector3::new(START_SIGMA.0.powi(-2), START_SIGMA.0.powi(-2), START_SIGMA.1.powi(-2));
            let prior = SurfacePrior { pose: start, information: Matrix3::from_diagonal(&sigma) };
            fits.extend(self.map.fit(&self.points, &prior));
        }
        fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let best = *fits.first()?;
        let margin = AMBIGUOUS_PER_POINT * self.points.len() as f64;
        let is_other_place = |fit: &SurfaceFit| is_apart(fit.pose, best.pose);
        let is_ambiguous = fits.iter().any(|fit| is_other_place(fit) && fit.cost < best.cost + margin);
        (best.inliers >= inliers_min(best.pose) && !is_ambiguous).then_some(best)
    }

    /// Poses from which the query is fitted: the expected one, and in a wide window those of the best scores on a lattice.
    fn starts(&mut self, guess: Placement, window: Window) -> Vec<Pose> {
        let mut starts = vec![guess.pose()];
        let axis = |reach: f64, step: f64, most: i32| {
            let count = ((reach / step).ceil() as i32).clamp(0, most);
            (count, if count > 0 { reach / f64::from(count) } else { 0.0 })
        };
        let ((shifts, step_m), (turns, step_rad)) =
            (axis(window.reach_m, 0.5, COARSE.0), axis(window.turn_rad, 0.03, COARSE.1));
        let stride = self.points.len().div_ceil(COARSE_POINTS).max(1);
        let mut scored: Vec<(i32, Pose)> = Vec::new();
        self.counts.take(&self.map, FULL_CELL);
        let shift_m = |guess_m: f64, shift: i32| guess_m + f64::from(shift) * step_m;
        for turn in -turns..=turns {
            let turned = Placement::new(0.0, 0.0, guess.heading_rad + f64::from(turn) * step_rad);
            let ends: Vec<(f64, f64)> =
                self.points.iter().step_by(stride).map(|p| turned.rotate(p.x_m, p.y_m)).collect();
            // A shift along one axis changes the column or the row alone.
            let columns =
                cells(-shifts..=shifts, &ends, |i, end| SurfaceCounts::column(shift_m(guess.x_m, i) + end.0));
            let rows =
                cells(-shifts..=shifts, &ends, |k, end| SurfaceCounts::row(shift_m(guess.y_m, k) + end.1));
            for (k, rows) in (-shifts..=shifts).zip(rows.chunks_exact(ends.len())) {
                for (i, columns) in (-shifts..=shifts).zip(columns.chunks_exact(ends.len())) {
                    let full = |(column, row): (&u32, &u32)| i32::from(self.counts.at(*column, *row));
                    let score = columns.iter().zip(rows).map(full).sum();
                    let (x, y) = (shift_m(guess.x_m, i), shift_m(guess.y_m, k));
                    scored.push((score, Pose::new(x, y, turned.heading_rad)));
                }
            }
        }
        scored.sort_by_key(|(score, _)| std::cmp::Reverse(*score));
        for (_, pose) in scored {
            if starts.len() > STARTS {
                break;
            }
            if starts.iter().all(|start| is_apart(*start, pose)) {
                starts.push(pose);
            }
        }
        starts
    }
}

/// A window no wider than a solution is uncertain.
fn narrowed(window: Window, [x_m, y_m, turn_rad]: [f64; 3]) -> Window {
    Window {
        reach_m: window.reach_m.min(NARROW_M.max(SIGMAS * hypot(x_m, y_m))),
        turn_rad: window.turn_rad.min(0.06 + SIGMAS * turn_rad),
    }
}

/// The columns or rows of all points at each shift.
fn cells(
    shifts: RangeInclusive<i32>,
    ends: &[(f64, f64)],
    cell: impl Fn(i32, &(f64, f64)) -> u32,
) -> Vec<u32> {
    let cell = &cell;
    shifts.flat_map(|shift| ends.iter().map(move |end| cell(shift, end))).collect()
}

/// The least share of inliers of a match at this pose: where the robot looks sideways nearly that of one that looks the same way.
fn inliers_min(found: Pose) -> f64 {
    let turned = turned(found);
    INLIERS_MIN - OTHER_SIDE_INLIERS * turned * turned
}

/// How far a robot looks back, from 0 to 1.
fn turned(found: Pose) -> f64 {
    let half = sin(0.5 * found.heading_rad);
    half * half
}

fn is_within(window: Window, guess: Pose, found: Pose) -> bool {
    found.distance_m(guess) <= window.reach_m + OUTSIDE.0
        && found.turn_rad(guess) <= window.turn_rad + OUTSIDE.1
}

fn is_apart(a: Pose, b: Pose) -> bool {
    a.distance_m(b) > APART.0 || a.turn_rad(b) > APART.1
}

/// The older nodes nearest to a query, one of each pass, with the window in which it is looked for there.
fn stretches(world: &World<'_>, query: usize, distances_m: &[f64]) -> Vec<(usize, Window)> {
    let travel_m = world.nodes[query].travel_m;
    let mut near: Vec<(f64, usize, Window)> = Vec::new();
    for (i, node) in world.nodes[..query].iter().enumerate() {
        if travel_m - node.travel_m < LEAST_TRAVEL_M {
            break;
        }
        if distances_m[i] >= BROKEN_M {
            continue;
        }
        let (apart_m, window) = (world.poses[i].distance_m(&world.poses[query]), window(distances_m[i]));
        if apart_m <= SIGHT_M + window.reach_m {
            near.push((apart_m, i, window));
        }
    }
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<(usize, Window)> = Vec::new();
    for (_, i, window) in near {
        let is_new = |other: &(usize, Window)| {
            (world.nodes[other.0].travel_m - world.nodes[i].travel_m).abs() > 2.0 * STRETCH_M
        };
        if chosen.len() < STRETCHES && chosen.iter().all(is_new) {
            chosen.push((i, window));
        }
    }
    chosen
}

/// The nodes whose points make a query.
fn own_range(world: &World<'_>, query: usize) -> Range<usize> {
    let nodes = world.nodes;
    let same = |i: &usize| {
        nodes[*i].trajectory == nodes[query].trajectory
            && nodes[query].travel_m - nodes[*i].travel_m <= QUERY_M
    };
    let first = (0..=query).rev().take_while(same).last().unwrap_or(query);
    let end = (query..nodes.len().min(query + QUERY_AFTER + 1)).take_while(same).last().unwrap_or(query);
    first..end + 1
}

/// Information of a match in the axes of its older node; `None` when it leaves a direction open.
fn information(fit: &SurfaceFit) -> Option<Symmetric> {
    let m = &fit.information;
    let points: Symmetric = [m[(0, 0)], m[(0, 1)], m[(0, 2)], m[(1, 1)], m[(1, 2)], m[(2, 2)]];
    let covariance = inverse(&points)?;
    let is_known = covariance[0].max(covariance[3]) <= SIGMA_MAX.0 * SIGMA_MAX.0
        && covariance[5] <= SIGMA_MAX.1 * SIGMA_MAX.1;
    let turned = turned(fit.pose);
    let slack = (SLACK.0 + turned * OTHER_SIDE.0, SLACK.1 + turned * OTHER_SIDE.1);
    if is_known { inflated(&points, slack.0, slack.1) } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn a_robot_that_looks_back_needs_fewer_inliers_and_one_that_looks_sideways_hardly() {
        let least = |heading_rad| inliers_min(Pose::new(3.0, -1.0, heading_rad));
        assert_eq!(least(0.0), INLIERS_MIN);
        assert!((least(PI) - (INLIERS_MIN - OTHER_SIDE_INLIERS)).abs() < 1e-9);
        assert!(least(0.5 * PI) > INLIERS_MIN - 0.05 && least(-0.5 * PI) == least(0.5 * PI));
    }

    #[test]
    fn a_window_is_no_wider_than_the_solution_is_uncertain_and_never_wider_than_before() {
        let wide = Window { reach_m: 25.0, turn_rad: 0.7 };
        let of = |sigma_m, sigma_rad| narrowed(wide, [sigma_m, 0.0, sigma_rad]);
        assert_eq!((of(0.5, 0.01).reach_m, of(0.01, 0.01).reach_m), (SIGMAS * 0.5, NARROW_M));
        assert!((of(0.5, 0.01).turn_rad - (0.06 + SIGMAS * 0.01)).abs() < 1e-9);
        assert_eq!((of(50.0, 3.0).reach_m, of(50.0, 3.0).turn_rad), (25.0, 0.7));
    }
}
