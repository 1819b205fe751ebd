//! Groups of closures between robots that agree with each other (pairwise consistency, after Mangelson et al. 2018, with cliques grown greedily): says
//! which closures may take part in a solution.

use flockslam_loop_closure::agreement::agree;
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::node::Node;
use flockslam_pose_graph::Edge;
use flockslam_registration::cloud::Placement;
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Matches that have to agree before two robots are connected, including the one in question.
const GROUP_MIN: usize = 3;
/// Travel over which those that agree must extend, on both sides together and on either, metres: what looks alike over a few metres differs
/// over more. On one side little is enough: a robot that stands in a room sees all of it.
const EXTENT_M: (f64, f64) = (6.5, 0.5);
/// Groups of each pair of trajectories that are inspected, the largest first: the work is bounded for any input.
const GROUPS_MAX: usize = 12;
/// Each closure is compared with so many on either side of it along the way: the work is bounded for any input.
const BAND: usize = 128;
/// Groups that lie along the way farther apart than this say nothing of each other, metres.
const RELATED_WITHIN_M: f64 = 100.0;
/// What the way between two groups may have bent, as (metres, share of the way, per metre of way squared) and (radians, per metre).
const BENT: ((f64, f64, f64), (f64, f64)) = ((0.3, 0.02, 0.002), (0.08, 0.004));

/// Which closures between robots may take part in a solution; `across` says which are between robots, all others are not checked
/// and come out as `false`.
///
/// A closure needs a group of at least three that agree with each other, that extends over several metres and that `stands` by what
/// the robots have seen: any number of false closures that do not agree with each other counts as none. Where two groups contradict each other and are about
/// as strong, neither acts (pairwise consistency, after Mangelson et al. 2018, with cliques grown greedily).
pub fn consistent(
    closures: &[Closure],
    nodes: &[Node],
    across: &[bool],
    stands: &mut dyn FnMut(&[usize]) -> bool,
) -> Vec<bool> {
    let mut pairs: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
    for (i, closure) in closures.iter().enumerate().filter(|(i, _)| across[*i]) {
        let connectivity = (nodes[closure.edge.from].trajectory, nodes[closure.edge.to].trajectory);
        pairs.entry(connectivity).or_default().push(i);
    }
    let mut consistent = vec![false; closures.len()];
    for mut members in pairs.into_values() {
        members.sort_by(|a, b| in_order(&closures[*a].edge, &closures[*b].edge, nodes));
        let compared = Compared::new(&members, closures, nodes);
        let confirmed: Vec<bool> = (0..members.len()).map(|i| compared.is_confirmed(i)).collect();
        let mut groups = compared.groups(&confirmed, closures, nodes);
        groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
        groups.truncate(GROUPS_MAX);
        let groups = compared.accepted(groups, closures, nodes, stands);
        for i in winners(&groups, &compared, closures, nodes) {
            consistent[members[i]] = true;
        }
    }
    consistent
}

/// The order of closures along the way, in whatever order they were received.
fn in_order(a: &Edge, b: &Edge, nodes: &[Node]) -> Ordering {
    let key = |e: &Edge| {
        let Placement { x_m, y_m, heading_rad, .. } = e.motion;
        [nodes[e.to].drift_bound_m, nodes[e.from].drift_bound_m, x_m, y_m, heading_rad]
    };
    let pairs = key(a).into_iter().zip(key(b));
    pairs.map(|(a, b)| a.total_cmp(&b)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
}

/// All closures between two trajectories in the order of their places, each compared with those that follow it.
struct Compared<'a> {
    members: &'a [usize],
    /// By closure: which of the next [`BAND`] agree with it, and which contradict it.
    after: Vec<(u128, u128)>,
}

impl<'a> Compared<'a> {
    fn new(members: &'a [usize], closures: &[Closure], nodes: &[Node]) -> Self {
        let compare = |i: usize| {
            let a = &closures[members[i]];
            let (mut agreeing, mut alternatives) = (0, 0);
            for (bit, k) in (i + 1..members.len().min(i + 1 + BAND)).enumerate() {
                match agree(a, &closures[members[k]], nodes) {
                    Some(true) => agreeing |= 1 << bit,
                    Some(false) => alternatives |= 1 << bit,
                    None => {}
                }
            }
            (agreeing, alternatives)
        };
        Self { members, after: (0..members.len()).map(compare).collect() }
    }

    /// Whether two closures agree; `None` when they cannot be compared.
    fn agree(&self, i: usize, k: usize) -> Option<bool> {
        let (low, high) = (i.min(k), i.max(k));
        let bit = (high - low).checked_sub(1).filter(|bit| *bit < BAND)?;
        let (agreeing, alternatives) = self.after[low];
        match (agreeing >> bit & 1 == 1, alternatives >> bit & 1 == 1) {
            (true, _) => Some(true),
            (_, true) => Some(false),
            _ => None,
        }
    }

    fn near(&self, i: usize) -> impl Iterator<Item = usize> + use<'_, 'a> {
        (i.saturating_sub(BAND)..self.members.len().min(i + 1 + BAND)).filter(move |k| *k != i)
    }

    /// Whether enough closures agree with this one and do not contradict each other.
    fn is_confirmed(&self, i: usize) -> bool {
        let agreeing: Vec<usize> = self.near(i).filter(|k| self.agree(i, *k) == Some(true)).collect();
        agreeing.len() + 1 >= GROUP_MIN && 1 + self.clique(&agreeing) >= GROUP_MIN
    }

    /// Size of a set in which no two contradict each other, grown from those that most agree with: never more than the largest there is.
    fn clique(&self, among: &[usize]) -> usize {
        let votes = |i: usize| among.iter().filter(|k| self.agree(i, **k) == Some(true)).count();
        let mut order: Vec<(usize, usize)> = among.iter().map(|i| (votes(*i), *i)).collect();
        order.sort_by_key(|(votes, i)| (std::cmp::Reverse(*votes), *i));
        let mut clique: Vec<usize> = Vec::new();
        for (_, i) in order {
            if clique.iter().all(|k| self.agree(i, *k) != Some(false)) {
                clique.push(i);
            }
        }
        clique.len()
    }

    /// Of these groups, the largest first, those that are on standby what was seen, or that one that does confirms.
    fn accepted(
        &self,
        groups: Vec<Vec<usize>>,
        closures: &[Closure],
        nodes: &[Node],
        stands: &mut dyn FnMut(&[usize]) -> bool,
    ) -> Vec<Vec<usize>> {
        let mut accepted: Vec<Vec<usize>> = Vec::new();
        for group in groups {
            let is_confirmed =
                accepted.iter().any(|other| self.relation(other, &group, closures, nodes) == Some(true));
            if is_confirmed || stands(&group.iter().map(|i| self.members[*i]).collect::<Vec<_>>()) {
                accepted.push(group);
            }
        }
        accepted
    }

    /// Whether two groups agree; `None` when they lie too far apart to be compared.
    fn relation(&self, a: &[usize], b: &[usize], closures: &[Closure], nodes: &[Node]) -> Option<bool> {
        let closure = |i: usize| &closures[self.members[i]];
        let pairs = a.iter().flat_map(|i| b.iter().map(move |k| (*i, *k)));
        let ways = pairs.map(|(i, k)| (way_m(closure(i), closure(k), nodes), i, k));
        let (way_m, i, k) = ways.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (way_m <= RELATED_WITHIN_M).then(|| are_related(closure(i), closure(k), nodes, way_m))
    }

    /// Confirmed closures by those that agree directly or over others; small and short groups are left out.
    fn groups(&self, confirmed: &[bool], closures: &[Closure], nodes: &[Node]) -> Vec<Vec<usize>> {
        let mut parent: Vec<usize> = (0..self.members.len()).collect();
        let first = |parent: &[usize], mut i: usize| {
            while parent[i] != i {
                i = parent[i];
            }
            i
        };
        for i in (0..self.members.len()).filter(|i| confirmed[*i]) {
            let near = i + 1..self.members.len().min(i + 1 + BAND);
            for k in near.filter(|k| confirmed[*k]) {
                if self.agree(i, k) == Some(true) {
                    let (a, b) = (first(&parent, i), first(&parent, k));
                    parent[a.max(b)] = a.min(b);
                }
            }
        }
        let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for i in (0..self.members.len()).filter(|i| confirmed[*i]) {
            groups.entry(first(&parent, i)).or_default().push(i);
        }
        let is_enough = |group: &Vec<usize>| {
            let ends = group.iter().map(|i| closures[self.members[*i]].edge);
            let extent_m = |at: fn(&Edge) -> usize| {
                let travel = ends.clone().map(|edge| nodes[at(&edge)].travel_m);
                let (low, high) = travel
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), m| (low.min(m), high.max(m)));
                high - low
            };
            let extents_m = [extent_m(|edge| edge.from), extent_m(|edge| edge.to)];
            group.len() >= GROUP_MIN
                && extents_m.iter().sum::<f64>() >= EXTENT_M.0
                && extents_m.iter().all(|extent_m| *extent_m >= EXTENT_M.1)
        };
        groups.into_values().filter(is_enough).collect()
    }
}

/// The closures of the largest group and of all that fit to it, unless one that does not is more than half as large.
fn winners(
    groups: &[Vec<usize>],
    compared: &Compared<'_>,
    closures: &[Closure],
    nodes: &[Node],
) -> Vec<usize> {
    let largest = (0..groups.len()).max_by_key(|i| (groups[*i].len(), std::cmp::Reverse(*i)));
    let Some(best) = largest else { return Vec::new() };
    let fits = |group: &Vec<usize>| compared.relation(&groups[best], group, closures, nodes) != Some(false);
    let (fitting, contrary): (Vec<_>, Vec<_>) = groups.iter().partition(|group| fits(group));
    if contrary.iter().any(|group| 2 * group.len() > groups[best].len()) {
        return Vec::new();
    }
    fitting.into_iter().flatten().copied().collect()
}

fn way_m(a: &Closure, b: &Closure, nodes: &[Node]) -> f64 {
    let between = |i: usize, k: usize| (nodes[i].drift_bound_m - nodes[k].drift_bound_m).abs();
    between(a.edge.from, b.edge.from) + between(a.edge.to, b.edge.to)
}

/// Whether the cycle over two closures closes within the covariance of the odometry between them.
fn are_related(a: &Closure, b: &Closure, nodes: &[Node], way_m: f64) -> bool {
    let driven = |i: usize, k: usize| nodes[i].local_pose.to(nodes[k].local_pose);
    let around = a.edge.motion.compose(driven(a.edge.to, b.edge.to));
    let along = driven(a.edge.from, b.edge.from).compose(b.edge.motion);
    let ((gap_m, share, bend), (turn_rad, turn_rad_m)) = BENT;
    along.distance_m(&around) <= gap_m + (share + bend * way_m) * way_m
        && along.turn_rad(&around) <= turn_rad + turn_rad_m * way_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NODES: usize = 60;

    /// Two trajectories of nodes a metre apart, along curves of their own.
    fn nodes() -> Vec<Node> {
        let node = |k: usize| {
            let (trajectory, along) = ((k / NODES) as u32, (k % NODES) as f64);
            let angle = 0.02 * along * (1.0 + f64::from(trajectory));
            let at = Placement::new(along, 3.0 * angle.sin(), angle);
            let drift_bound_m = along + 1e6 * f64::from(trajectory);
            Node {
                scan: k,
                sequence: k as u64,
                odom: at,
                local_pose: at,
                start: at,
                travel_m: along,
                drift_bound_m,
                trajectory,
                is_open: false,
                is_given: false,
            }
        };
        (0..2 * NODES).map(node).collect()
    }

    /// The closure between nodes of both trajectories if this is the pose of the second in the first.
    fn closure(nodes: &[Node], from: usize, to: usize, first_from_second: Placement) -> Closure {
        let motion = nodes[from].local_pose.to(first_from_second.compose(nodes[NODES + to].local_pose));
        let information = [600.0, 0.0, 0.0, 600.0, 0.0, 1e4];
        Closure { edge: Edge { from, to: NODES + to, motion, information }, reach_m: 14.0, shift_m: 2.0 }
    }

    fn inlier_flags(closures: &[Closure], nodes: &[Node]) -> Vec<bool> {
        consistent(closures, nodes, &vec![true; closures.len()], &mut |_| true)
    }

    fn at(x_m: f64) -> Placement {
        Placement::new(x_m, -4.0, 0.7)
    }

    #[test]
    fn three_that_agree_over_a_stretch_are_needed() {
        let nodes = nodes();
        let mut closures = vec![closure(&nodes, 10, 20, at(0.0)), closure(&nodes, 13, 23, at(0.1))];
        assert_eq!(inlier_flags(&closures, &nodes), [false; 2]);
        closures.push(closure(&nodes, 11, 21, at(0.0)));
        assert_eq!(inlier_flags(&closures, &nodes), [false; 3], "three metres are too short");
        closures.push(closure(&nodes, 16, 26, at(0.05)));
        assert_eq!(inlier_flags(&closures, &nodes), [true; 4]);
    }

    #[test]
    fn where_a_alternative_explanation_is_nearly_as_strong_neither_acts() {
        let nodes = nodes();
        let group = |count: usize, x_m: f64| -> Vec<Closure> {
            (0..count).map(|k| closure(&nodes, 10 + 2 * k, 20 + 2 * k, at(x_m))).collect()
        };
        let both = |alternatives: usize| [group(6, 0.0), group(alternatives, 3.0)].concat();
        assert_eq!(inlier_flags(&both(4), &nodes), [false; 10]);
        let inlier_flags = inlier_flags(&both(3), &nodes);
        assert!(
            inlier_flags[..6].iter().all(|is_inlier| *is_inlier)
                && !inlier_flags[6..].iter().any(|is_inlier| *is_inlier)
        );
    }

    #[test]
    fn groups_far_apart_must_agree() {
        let nodes = nodes();
        let group = |first: usize, count: usize, x_m: f64| -> Vec<Closure> {
            (0..count).map(|k| closure(&nodes, first + 2 * k, first + 2 * k, at(x_m))).collect()
        };
        let both = |x_m: f64, count: usize| [group(2, 6, 0.0), group(40, count, x_m)].concat();
        assert_eq!(inlier_flags(&both(1.0, 5), &nodes), [true; 11], "a bent way explains a metre");
        assert_eq!(inlier_flags(&both(20.0, 5), &nodes), [false; 11], "two contradicting groups");
        let one = inlier_flags(&both(20.0, 3), &nodes);
        assert!(one[..6].iter().all(|is_inlier| *is_inlier) && !one[6..].iter().any(|is_inlier| *is_inlier));
    }

    proptest! {
        #[test]
        fn as_many_false_closures_as_true_ones_neither_act_nor_veto(
            truths in prop::collection::vec((0usize..40, -0.05..0.05f64, -0.01..0.01f64), 8..30),
            false_ones in prop::collection::vec((0..NODES, 0..NODES, -20.0..20.0f64, -20.0..20.0f64, -3.1..3.1f64), 30),
            shuffle in any::<u64>(),
        ) {
            let nodes = nodes();
            let spans = |low: usize, high: usize| truths.iter().any(|t| t.0 == low) && truths.iter().any(|t| t.0 == high);
            let (low, high) = (truths.iter().map(|t| t.0).min().unwrap(), truths.iter().map(|t| t.0).max().unwrap());
            prop_assume!(spans(low, high) && high - low >= 8);
            let mut closures: Vec<(bool, Closure)> = truths
                .iter()
                .map(|&(k, x, turn)| {
                    let moved = closure(&nodes, k, k + 10, at(0.0));
                    let motion = moved.edge.motion.compose(Placement::new(x, -x, turn));
                    (true, Closure { edge: Edge { motion, ..moved.edge }, ..moved })
                })
                .collect();
            closures.extend(false_ones.iter().take(truths.len()).map(|&(from, to, x, y, turn)| {
                (false, closure(&nodes, from, to, Placement::new(x, y, turn)))
            }));
            // The order in which they are known does not matter.
            let mut order: Vec<usize> = (0..closures.len()).collect();
            order.sort_by_key(|i| (*i as u64 + 1).wrapping_mul(shuffle | 1));
            let shuffled: Vec<Closure> = order.iter().map(|i| closures[*i].1).collect();
            let straight: Vec<Closure> = closures.iter().map(|c| c.1).collect();
            let (a, b) = (inlier_flags(&straight, &nodes), inlier_flags(&shuffled, &nodes));
            let mut inliers = 0;
            for (place, i) in order.iter().enumerate() {
                prop_assert_eq!(a[*i], b[place]);
                let (is_true, false_closure) = closures[*i];
                inliers += usize::from(is_true && a[*i]);
                let inlier = closure(&nodes, false_closure.edge.from, false_closure.edge.to - NODES, at(0.0)).edge.motion;
                let off = (inlier.distance_m(&false_closure.edge.motion), inlier.turn_rad(&false_closure.edge.motion));
                prop_assert!(!a[*i] || off.0 < 1.5 && off.1 < 0.2, "a false closure acts that is off by {:?}", off);
            }
            prop_assert!(inliers > 0 || !is_dense(&truths), "no truth acts of {}", truths.len());
        }
    }

    /// Whether truths follow each other closely enough to be compared.
    fn is_dense(truths: &[(usize, f64, f64)]) -> bool {
        let mut places: Vec<usize> = truths.iter().map(|t| t.0).collect();
        places.sort_unstable();
        places.windows(2).all(|pair| pair[1] - pair[0] <= 5)
    }
}
