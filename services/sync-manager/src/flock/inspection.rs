use super::Atlas;
use super::layout::Solved;
use crate::closure::{ClosureFinder, Look, World};
use std::collections::BTreeSet;

/// Places that are looked at for each pair of robots, of those where closures say that it is the same, and of others.
const PLACES: usize = 24;
/// Two robots have seen the same place when they came as close as this, metres.
const NEAR_M: f64 = 2.5;
/// Travel between two such places, metres.
const EVERY_M: f64 = 1.0;
/// A place says something when this share of the points of one side lies on lines of the other; so many places must.
const INLIERS_MIN: f64 = 0.6;
const AGREEING_MIN: usize = 3;
/// Shares of the points of both sides in space that the other saw free, added up, on average over these places: what is the same
/// has up to 0.05 in most logs and in simulated buildings, what only looks alike 0.1 and more.
const INTRUDING_MAX: f64 = 0.07;

impl Atlas {
    /// Closures that act between robots whose maps, as they would tie them together, contradict each other.
    ///
    /// Buildings are full of things that look alike: a few matches that agree can always be found. Where robots are tied together
    /// rightly, everything that both have seen is the same.
    pub(super) fn contradicted(&self, solved: &Solved, finder: &mut ClosureFinder) -> Vec<usize> {
        let acting: Vec<usize> = (0..self.closures.len())
            .filter(|i| solved.in_force[*i] && self.is_across(&self.closures[*i]))
            .collect();
        let logs = |i: usize| (self.owner(self.closures[i].edge.from), self.owner(self.closures[i].edge.to));
        let pairs: BTreeSet<(u32, u32)> = acting.iter().map(|i| logs(*i)).collect();
        let mut denied = BTreeSet::new();
        for pair in pairs {
            let claimed: Vec<usize> = acting.iter().copied().filter(|i| logs(*i) == pair).collect();
            if !self.look_alike(pair, &claimed, solved, finder) {
                denied.insert(pair);
            }
        }
        acting.into_iter().filter(|i| denied.contains(&logs(*i))).collect()
    }

    /// Whether what both logs have seen looks the same: where closures say that it does, and wherever else they came near each other.
    fn look_alike(
        &self,
        (a, b): (u32, u32),
        claimed: &[usize],
        solved: &Solved,
        finder: &mut ClosureFinder,
    ) -> bool {
        let world =
            World { nodes: &self.nodes, scans: &self.scans, segments: &self.segments, poses: &solved.poses };
        let claimed: Vec<(usize, usize)> = claimed.iter().filter_map(|i| self.claim(*i)).collect();
        let mut looks: Vec<Look> = Vec::new();
        for places in [claimed, self.shared_places(a, b, solved)] {
            let stride = places.len().div_ceil(PLACES).max(1);
            let few = places.into_iter().step_by(stride);
            looks.extend(few.filter_map(|(node, segment)| finder.look(&world, node, segment)));
        }
        looks.retain(|look| look.inliers >= INLIERS_MIN);
        let count = looks.len();
        let intruding: f64 = looks.iter().map(|look| look.intruding + look.intruded).sum();
        count >= AGREEING_MIN && intruding <= INTRUDING_MAX * count as f64
    }

    /// The node that a closure leads to, and the segment that it starts from.
    fn claim(&self, closure: usize) -> Option<(usize, usize)> {
        let edge = &self.closures[closure].edge;
        let segment = self.segments.partition_point(|segment| segment.nodes.end <= edge.from);
        self.segments.get(segment).filter(|s| s.nodes.contains(&edge.from)).map(|_| (edge.to, segment))
    }

    /// Nodes of the second log that lie near segments of the first, each with the nearest.
    fn shared_places(&self, a: u32, b: u32, solved: &Solved) -> Vec<(usize, usize)> {
        let part = |node: usize| solved.strands.part(self.nodes[node].strand);
        let theirs: Vec<usize> =
            (0..self.segments.len()).filter(|k| self.owner(self.segments[*k].anchor) == a).collect();
        let mut shared = Vec::new();
        let mut next_m = f64::NEG_INFINITY;
        for node in self.logs[b as usize].nodes.clone() {
            if self.nodes[node].travel_m < next_m {
                continue;
            }
            let at = solved.poses[node];
            let near = |k: &&usize| {
                let segment = &self.segments[**k];
                part(segment.anchor) == part(node) && solved.poses[segment.anchor].distance_m(&at) < 10.0
            };
            let apart_m = |k: &usize| {
                let nodes = self.segments[*k].nodes.clone();
                nodes.map(|i| solved.poses[i].distance_m(&at)).fold(f64::INFINITY, f64::min)
            };
            let nearest =
                theirs.iter().filter(near).map(|k| (apart_m(k), *k)).min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, segment)) = nearest.filter(|(apart_m, _)| *apart_m <= NEAR_M) {
                shared.push((node, segment));
                next_m = self.nodes[node].travel_m + EVERY_M;
            }
        }
        shared
    }
}
