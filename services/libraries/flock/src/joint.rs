//! Closures between robots that are connected already: those that lie where the solution expects them may act with less confirmation.

use super::FlockGraph;
use super::flock_solution::Solved;
use super::inspection::Inspected;
use flockslam_loop_closure::agreement::eligible;
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::finder::window;
use flockslam_loop_closure::graph_distances::{CLOSURE_M, graph_distances};
use std::collections::BTreeMap;

/// Closures that are looked at in one go: the work is bounded for any input.
const LOOKED_AT_MAX: usize = 1024;

impl FlockGraph {
    /// Of the closures between robots that are outliers yet those that a solution which ties these robots together already leads one to
    /// expect: their poses agree with it within the covariance of the odometry between; they need no more than a robot's own closures do, and
    /// what both have seen there must be the same. No robot is connected to another by these.
    pub(super) fn expected(&self, solved: &Solved, inspected: &mut Inspected) -> Vec<usize> {
        let part = |node: usize| solved.connectivity.part(self.nodes[node].trajectory);
        let is_open = |i: &usize| {
            let edge = &self.closures[*i].edge;
            !solved.is_inlier[*i] && self.is_across(&self.closures[*i]) && part(edge.from) == part(edge.to)
        };
        let mut by_query: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for i in (0..self.closures.len()).filter(is_open).take(LOOKED_AT_MAX) {
            by_query.entry(self.closures[i].edge.to).or_default().push(i);
        }
        let mut likely: Vec<usize> = Vec::new();
        let mut candidates: Vec<Closure> = Vec::new();
        for (query, members) in by_query {
            let distances_m = self.distances_m(solved, query);
            for i in members {
                if let Some(closure) = self.as_expected(solved, &self.closures[i], &distances_m) {
                    likely.push(i);
                    candidates.push(closure);
                }
            }
        }
        // Those that are inliers already count as partners of those that may.
        let inliers = |i: &usize| solved.is_inlier[*i] && self.is_across(&self.closures[*i]);
        candidates.extend((0..self.closures.len()).filter(inliers).map(|i| self.closures[i]));
        let eligible = eligible(&candidates, &self.nodes);
        let eligible = likely.into_iter().zip(eligible).filter(|(_, eligible)| *eligible).map(|(i, _)| i);
        let mut expected: Vec<usize> =
            eligible.filter(|i| self.is_the_same_there(&self.closures[*i], inspected)).collect();
        expected.sort_unstable();
        expected
    }

    /// Metres from a node to every other over the trajectories and the inlier closures.
    pub(super) fn distances_m(&self, solved: &Solved, node: usize) -> Vec<f64> {
        let inliers = self.closures.iter().zip(&solved.is_inlier).filter(|(_, is_inlier)| **is_inlier);
        let loops: Vec<_> = inliers.map(|(c, _)| (c.edge.from, c.edge.to, CLOSURE_M)).collect();
        graph_distances(&self.nodes, &loops, node)
    }

    /// A closure with the window that it would have been found in by this solution, if it is in that.
    fn as_expected(&self, solved: &Solved, closure: &Closure, distances_m: &[f64]) -> Option<Closure> {
        let (from, to) = (closure.edge.from, closure.edge.to);
        let expected = solved.poses[from].to(solved.poses[to]);
        let window = window(distances_m[from]);
        let shift_m = expected.distance_m(&closure.edge.motion);
        let is_inside =
            shift_m <= window.reach_m && expected.turn_rad(&closure.edge.motion) <= window.turn_rad;
        is_inside.then_some(Closure { reach_m: window.reach_m, shift_m, ..*closure })
    }
}
