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
/// Places that must agree.
const AGREEING_MIN: u32 = 3;
/// Places that contradict a tie, for each that agrees, from which it is not believed.
const CONTRADICTING_MAX: f64 = 0.34;

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
        let (mut agreeing, mut contradicting) = (0u32, 0u32);
        for places in [claimed, self.shared_places(a, b, solved)] {
            let stride = places.len().div_ceil(PLACES).max(1);
            for (node, segment) in places.into_iter().step_by(stride) {
                match finder.look(&world, node, segment) {
                    Look::Agrees => agreeing += 1,
                    Look::Contradicts => contradicting += 1,
                    Look::Silent => {}
                }
            }
        }
        if std::env::var("INSPECT").is_ok() {
            eprintln!("look {a} {b}: {agreeing} agree, {contradicting} contradict");
        }
        agreeing >= AGREEING_MIN && f64::from(contradicting) <= CONTRADICTING_MAX * f64::from(agreeing)
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
