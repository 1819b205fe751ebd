//! Which loop closures are eligible: those found in wide windows or in the open need others that agree with them over the cycle of odometry and closures.

use crate::closure::Closure;
use crate::finder::ANYWHERE;
use crate::node::Node;
use flockslam_geometry::elementary::cos;
use flockslam_pose_graph::Edge;
use flockslam_registration::cloud::Placement;

/// Closures found in windows wider than this need others that agree, metres.
pub const WIDE_M: f64 = 1.5;
/// Others that a closure from a wide window needs.
const PARTNERS_MIN: usize = 2;
/// Travel over which closures that agree must extend for each metre that they would move the robot, and for each metre of it that
/// the usual drift does not account for: a share of the window. Within the usual drift little is enough, except in the open. There all
/// drift is usual, since one tree in sight hardly constrains the heading; on 30 simulated campuses no false matches that moved the robot by
/// more than 4 m agreed with each other over more than one metre for each metre of it.
///
/// Places that look alike over a few metres, as the ends of two aisles or the doors of two rooms, differ over more. Where places that
/// look alike are as far apart as the odometry may have drifted, the true place may never have been seen, so that no better match
/// contradicts a false one.
const EXTENT_PER_SHIFT: f64 = 2.0;
const EXTENT_PER_SURPRISE: f64 = 5.0;
const EXTENT_USUAL_M: f64 = 1.0;
const USUAL_SHARE: f64 = 0.25;
/// The same in the open at the end, where windows are as wide as the solution is uncertain, and the robot looks along its older way or back.
const EXTENT_USUAL_OPEN_M: f64 = 3.0;
/// A closure that would move the robot by no more than this share of its window needs no other, in the open at the end: of matches that
/// lie anywhere in a window, one of a hundred is so near the pose that was expected.
const EXPECTED_SHARE: f64 = 0.1;
/// From 45° on.
const SIDEWAYS_COS: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Two closures are compared when the odometry between them is no longer than this, both sides together, metres.
const COMPARED_WITHIN_M: f64 = 20.0;
/// In the open such as agree with each other over this much odometry belong together: hedges and rows of trees repeat over some metres, and a
/// match that is wrong there does not agree with what is found farther along.
const JOINED_WITHIN_OPEN_M: f64 = 60.0;
/// Two closures agree when their cycle closes within this, plus a share of the odometry in it, and this turn.
const CYCLE: (f64, f64, f64) = (0.2, 0.02, 0.05);

/// Which closures may take part in a solution: those from narrow windows; those from wide ones, within a trajectory, that lie where they were
/// expected and that nothing contradicts; and those from wide ones that at least two others confirm, that fewer than half as many contradict, and that
/// hold over the longer a stretch the farther they would move the robot. Of matches that were looked for all over another trajectory,
/// those of one query count once: what it sees is found in every segment that saw it, at the true place and at one that looks alike.
///
/// In the open, hedges and rows of trees hold a scan little along them, and those found near are no exception. Wrong ones lie anywhere
/// along a hedge: they contradict all others and each other. So only those count against one that agree among themselves, and more must
/// confirm it than these are.
///
/// In a long corridor with a door every few metres a single match is wrong easily, and what the odometry knows
/// after a hundred metres cannot contradict it.
pub fn eligible(closures: &[Closure], nodes: &[Node]) -> Vec<bool> {
    classified(closures, nodes, false)
}

/// Which loop closures may take part in the last solution: those that are [`eligible`], and those in the open that lie where they were
/// expected. While driving these wait for others: one that is wrong after all bends the map, and what would contradict it is then
/// looked for elsewhere.
pub fn eligible_at_the_end(closures: &[Closure], nodes: &[Node]) -> Vec<bool> {
    classified(closures, nodes, true)
}

/// Which closures are eligible, where `at_the_end` one in the open that was expected needs no others.
fn classified(closures: &[Closure], nodes: &[Node], at_the_end: bool) -> Vec<bool> {
    let is_expected = |closure: &Closure| {
        let (from, to) = (&nodes[closure.edge.from], &nodes[closure.edge.to]);
        let may_be_alone = if to.is_open { at_the_end } else { from.trajectory == to.trajectory };
        may_be_alone && closure.shift_m <= EXPECTED_SHARE * closure.reach_m
    };
    let neighbours = Neighbours::new(closures, nodes);
    let mut groups = Groups::new(closures, nodes);
    let is_wide = |closure: &Closure| closure.reach_m > WIDE_M;
    let is_open = |closure: &Closure| nodes[closure.edge.to].is_open;
    let mut eligible: Vec<bool> = closures.iter().map(|closure| !is_wide(closure)).collect();
    let mut contradicting = Vec::new();
    for (i, a) in closures.iter().enumerate().filter(|(_, a)| is_wide(a) || is_open(a)) {
        let by_query = is_anywhere(a, nodes);
        let [mut agreeing, mut contradicted] = [0; 2].map(|_| Counted::new(by_query));
        contradicting.clear();
        let joined_within_m = if is_open(a) { JOINED_WITHIN_OPEN_M } else { COMPARED_WITHIN_M };
        for k in neighbours.of(a, joined_within_m).filter(|k| closures[*k].edge != a.edge) {
            let way_m = way_between_m(a, &closures[k], nodes);
            if way_m > joined_within_m {
                continue;
            }
            let (is_compared, agrees) =
                (way_m <= COMPARED_WITHIN_M, cycle_closes(a, &closures[k], way_m, nodes));
            if agrees {
                groups.join(i, k);
                if is_compared && !(by_query && closures[k].edge.to == a.edge.to) {
                    agreeing.add(&closures[k]);
                }
            } else if is_compared {
                contradicting.push(k);
                contradicted.add(&closures[k]);
            }
        }
        let (agreeing, contradicted) = (agreeing.count, contradicted.count);
        eligible[i] = if is_open(a) {
            let partners_min = match is_wide(a) {
                _ if is_expected(a) => 0,
                true => PARTNERS_MIN,
                false => 1,
            };
            agreeing >= partners_min && agreeing >= united(&contradicting, closures, nodes)
        } else {
            let partners_min = if is_expected(a) { 0 } else { PARTNERS_MIN };
            agreeing >= partners_min && 2 * contradicted <= agreeing + 1
        };
    }
    let needs_extent = |closure: &Closure| is_wide(closure) && !is_expected(closure);
    for (i, closure) in closures.iter().enumerate().filter(|(_, closure)| needs_extent(closure)) {
        eligible[i] &=
            groups.extent_m(i) >= extent_needed_m(closure, nodes[closure.edge.to].is_open, at_the_end);
    }
    eligible
}

/// Whether a closure was looked for all over another trajectory.
fn is_anywhere(closure: &Closure, nodes: &[Node]) -> bool {
    let Edge { from, to, .. } = closure.edge;
    closure.reach_m == ANYWHERE.reach_m && nodes[from].trajectory != nodes[to].trajectory
}

/// Number of closures, or of their queries.
struct Counted {
    count: usize,
    by_query: bool,
    last: Option<usize>,
}

impl Counted {
    fn new(by_query: bool) -> Self {
        Self { count: 0, by_query, last: None }
    }

    /// Those of one query follow each other.
    fn add(&mut self, closure: &Closure) {
        let is_counted = self.by_query && self.last == Some(closure.edge.to);
        self.count += usize::from(!is_counted);
        self.last = Some(closure.edge.to);
    }
}

fn extent_needed_m(closure: &Closure, is_open: bool, at_the_end: bool) -> f64 {
    let extent_m = EXTENT_PER_SHIFT * closure.shift_m;
    if is_open && (!at_the_end || looks_sideways(closure)) {
        return extent_m;
    }
    if is_open {
        let surprise_m = (closure.shift_m - USUAL_SHARE * closure.reach_m).max(0.0);
        return extent_m.min(EXTENT_USUAL_OPEN_M) + EXTENT_PER_SHIFT * surprise_m;
    }
    let surprise_m = (closure.shift_m - USUAL_SHARE * closure.reach_m).max(0.0);
    if surprise_m == 0.0 { extent_m.min(EXTENT_USUAL_M) } else { extent_m + EXTENT_PER_SURPRISE * surprise_m }
}

/// Whether the robot looks rather across its older way than along it: it sees little of what it saw then.
fn looks_sideways(closure: &Closure) -> bool {
    cos(closure.edge.motion.heading_rad).abs() < SIDEWAYS_COS
}

/// Closures in the order of their queries: those that are compared are next to each other.
struct Neighbours<'a> {
    nodes: &'a [Node],
    /// Drift bound of the query and number of each closure.
    order: Vec<(f64, usize)>,
}

impl<'a> Neighbours<'a> {
    fn new(closures: &[Closure], nodes: &'a [Node]) -> Self {
        let named = |(i, closure): (usize, &Closure)| (nodes[closure.edge.to].drift_bound_m, i);
        let mut order: Vec<_> = closures.iter().enumerate().map(named).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Self { nodes, order }
    }

    /// Numbers of the closures whose queries are not too far from that of this one.
    fn of(&self, closure: &Closure, within_m: f64) -> impl Iterator<Item = usize> {
        let at_m = self.nodes[closure.edge.to].drift_bound_m;
        let from = self.order.partition_point(|(drift_bound_m, _)| *drift_bound_m < at_m - within_m);
        let near = self.order[from..].iter();
        near.take_while(move |(drift_bound_m, _)| *drift_bound_m <= at_m + within_m).map(|(_, i)| *i)
    }
}

/// Closures that agree with each other, directly or over others, and the travel over which their queries extend.
struct Groups {
    /// By closure: one of the same group with a smaller number, or itself.
    parent: Vec<usize>,
    /// By first closure of a group: first and last travel, metres.
    extent: Vec<(f64, f64)>,
}

impl Groups {
    fn new(closures: &[Closure], nodes: &[Node]) -> Self {
        let travel_m = |closure: &Closure| nodes[closure.edge.to].travel_m;
        Self {
            parent: (0..closures.len()).collect(),
            extent: closures.iter().map(|closure| (travel_m(closure), travel_m(closure))).collect(),
        }
    }

    fn first(&mut self, mut closure: usize) -> usize {
        while self.parent[closure] != closure {
            // Path compression: shortens the next search.
            self.parent[closure] = self.parent[self.parent[closure]];
            closure = self.parent[closure];
        }
        closure
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.first(a), self.first(b));
        let (kept, gone) = (a.min(b), a.max(b));
        self.parent[gone] = kept;
        let (low, high) = self.extent[gone];
        self.extent[kept] = (self.extent[kept].0.min(low), self.extent[kept].1.max(high));
    }

    fn extent_m(&mut self, closure: usize) -> f64 {
        let first = self.first(closure);
        let (low, high) = self.extent[first];
        high - low
    }
}

/// Size of the greatest group among these closures of one and all that agree with it.
fn united(group: &[usize], closures: &[Closure], nodes: &[Node]) -> usize {
    let partners = |i: &usize| {
        group.iter().filter(|k| *k == i || agree(&closures[*i], &closures[**k], nodes) == Some(true)).count()
    };
    group.iter().map(partners).max().unwrap_or(0)
}

/// Whether the cycle over two closures and the odometry between their ends closes; `None` when they lie too far
/// apart.
pub fn agree(a: &Closure, b: &Closure, nodes: &[Node]) -> Option<bool> {
    let way_m = way_between_m(a, b, nodes);
    (way_m <= COMPARED_WITHIN_M).then(|| cycle_closes(a, b, way_m, nodes))
}

/// Odometry between the ends of two closures, both sides together, metres.
fn way_between_m(a: &Closure, b: &Closure, nodes: &[Node]) -> f64 {
    // What is given does not drift.
    let are_given = |i: usize, k: usize| nodes[i].is_given && nodes[k].is_given;
    let drift_m = |i: usize, k: usize| (nodes[i].drift_bound_m - nodes[k].drift_bound_m).abs();
    let between = |i: usize, k: usize| if are_given(i, k) { 0.0 } else { drift_m(i, k) };
    between(a.edge.from, b.edge.from) + between(a.edge.to, b.edge.to)
}

/// Whether the cycle over two closures and so much odometry between their ends closes.
fn cycle_closes(a: &Closure, b: &Closure, way_m: f64, nodes: &[Node]) -> bool {
    let driven = |i: usize, k: usize| nodes[i].local_pose.to(nodes[k].local_pose);
    let around = a.edge.motion.compose(driven(a.edge.to, b.edge.to));
    let along = driven(a.edge.from, b.edge.from).compose(b.edge.motion);
    let gap: Placement = along.to(around);
    let length_m = (gap.x_m * gap.x_m + gap.y_m * gap.y_m).sqrt();
    length_m <= CYCLE.0 + CYCLE.1 * way_m && gap.heading_rad.abs() <= CYCLE.2
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_pose_graph::Edge;

    fn nodes() -> Vec<Node> {
        let node = |k: usize| {
            let travel_m = k as f64;
            let pose = Placement::new(travel_m, 0.0, 0.0);
            Node {
                scan: k,
                sequence: k as u64,
                odom: pose,
                local_pose: pose,
                start: pose,
                travel_m,
                drift_bound_m: travel_m,
                trajectory: 0,
                is_open: false,
                is_given: false,
            }
        };
        (0..100).map(node).collect()
    }

    /// A closure whose motion is off by `off_m`, and which would move the robot by more than was expected.
    fn closure(from: usize, to: usize, off_m: f64, reach_m: f64) -> Closure {
        let motion = Placement::new(off_m, 1.0, 0.0);
        let edge = Edge { from, to, motion, information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] };
        Closure { edge, reach_m, shift_m: 0.2 * reach_m }
    }

    #[test]
    fn a_lone_match_from_a_wide_window_waits_for_two_that_agree() {
        let nodes = nodes();
        let mut closures = vec![closure(10, 90, 0.0, 8.0), closure(20, 50, 0.0, 0.5)];
        assert_eq!(eligible(&closures, &nodes), [false, true]);
        closures.push(closure(12, 92, 0.1, 8.0));
        assert_eq!(eligible(&closures, &nodes), [false, true, false]);
        closures.push(closure(13, 94, 1.05, 8.0));
        assert_eq!(eligible(&closures, &nodes), [true, true, true, true]);
    }

    #[test]
    fn a_query_found_in_many_segments_of_another_trajectory_is_one_match() {
        let mut nodes = nodes();
        nodes[50..].iter_mut().for_each(|node| node.trajectory = 1);
        let anywhere =
            |from, to, off_m| Closure { shift_m: 0.0, ..closure(from, to, off_m, ANYWHERE.reach_m) };
        let mut closures: Vec<_> = (0..4).map(|k| anywhere(10 + k, 90, -(k as f64))).collect();
        assert_eq!(eligible(&closures, &nodes), [false; 4]);
        closures.push(anywhere(12, 92, 0.0));
        assert_eq!(eligible(&closures, &nodes), [false; 5]);
        closures.push(anywhere(14, 94, 0.0));
        assert_eq!(eligible(&closures, &nodes), [true; 6]);
        // As many queries are found elsewhere.
        closures.extend((0..3).map(|k| anywhere(10 + 2 * k, 90 + 2 * k, 3.0)));
        assert_eq!(eligible(&closures, &nodes), [false; 9]);
    }

    #[test]
    fn a_lone_match_where_it_was_expected_does_not_wait_unless_another_contradicts_it() {
        let nodes = nodes();
        let expected = Closure { shift_m: 0.7, ..closure(10, 90, 0.0, 8.0) };
        assert_eq!(eligible(&[expected], &nodes), [true]);
        assert_eq!(eligible(&[expected, closure(11, 91, 3.0, 8.0)], &nodes), [false, false]);
    }

    #[test]
    fn the_farther_matches_move_the_robot_the_longer_they_must_hold() {
        let nodes = nodes();
        let mut closures: Vec<_> = (0..8).map(|k| closure(10 + 2 * k, 80 + 2 * k, 0.0, 8.0)).collect();
        closures.iter_mut().for_each(|closure| closure.shift_m = 3.5);
        assert_eq!(eligible(&closures, &nodes), [false; 8]);
        // The first and the last are too far apart to be compared: those between connect them.
        closures.push(Closure { shift_m: 3.5, ..closure(26, 96, 0.0, 8.0) });
        assert_eq!(eligible(&closures, &nodes), [true; 9]);
    }

    #[test]
    fn in_the_open_matches_that_agree_far_along_the_drive_extend_one_another() {
        let mut nodes = nodes();
        // 15 m from the last query of one group to the first of the other, and as much between their older nodes.
        let group = |first: usize| (0..4).map(move |k| closure(first + k, first + 40 + k, 0.0, 8.0));
        let mut closures: Vec<_> = group(5).chain(group(23)).collect();
        closures.iter_mut().for_each(|closure| closure.shift_m = 10.0);
        assert_eq!(eligible(&closures, &nodes), [false; 8], "21 m of travel are not enough in corridors");
        nodes.iter_mut().for_each(|node| node.is_open = true);
        assert_eq!(eligible(&closures, &nodes), [true; 8]);
        assert_eq!(eligible(&closures[..4], &nodes), [false; 4]);
        closures.iter_mut().for_each(|closure| closure.shift_m = 11.0);
        assert_eq!(eligible(&closures, &nodes), [false; 8]);
    }

    #[test]
    fn within_the_usual_drift_a_metre_of_agreement_is_enough() {
        let nodes = nodes();
        let mut closures: Vec<_> = (0..3).map(|k| closure(10 + k, 90 + k, 0.0, 8.0)).collect();
        assert_eq!(eligible(&closures, &nodes), [true; 3]);
        closures.iter_mut().for_each(|closure| closure.shift_m = 2.1);
        assert_eq!(eligible(&closures, &nodes), [false; 3]);
    }

    #[test]
    fn at_the_end_one_match_in_the_open_where_it_was_expected_is_enough() {
        let mut nodes = nodes();
        nodes.iter_mut().for_each(|node| node.is_open = true);
        let lone = |shift_m: f64| Closure { shift_m, ..closure(10, 90, 0.0, 8.0) };
        assert_eq!(eligible_at_the_end(&[lone(0.7)], &nodes), [true]);
        assert_eq!(eligible(&[lone(0.7)], &nodes), [false]);
        assert_eq!(eligible_at_the_end(&[lone(0.9)], &nodes), [false]);
        // Another that contradicts it makes both doubtful.
        let contradicted = [lone(0.7), closure(11, 91, 3.0, 8.0)];
        assert_eq!(eligible_at_the_end(&contradicted, &nodes), [false, false]);
    }

    #[test]
    fn at_the_end_matches_in_the_open_along_the_older_way_need_extent_for_the_surprise_alone() {
        let mut nodes = nodes();
        nodes.iter_mut().for_each(|node| node.is_open = true);
        // Three that agree over 3 m and would move the robot by 4 m, a quarter of the window.
        let turned = |heading_rad: f64| -> Vec<Closure> {
            let closure = |k: usize| {
                let mut closure = Closure { shift_m: 4.0, ..closure(10, 90 + k, 0.0, 16.0) };
                let along = nodes[90].local_pose.to(nodes[90 + k].local_pose);
                closure.edge.motion = Placement::new(0.0, 0.0, heading_rad).compose(along);
                closure
            };
            [0, 2, 3].map(closure).to_vec()
        };
        for (heading_rad, expected) in [(0.0, true), (3.0, true), (1.5, false), (-1.6, false)] {
            assert_eq!(eligible_at_the_end(&turned(heading_rad), &nodes), [expected; 3], "{heading_rad}");
            assert_eq!(eligible(&turned(heading_rad), &nodes), [false; 3], "{heading_rad}");
        }
    }

    #[test]
    fn as_many_that_disagree_keep_it_waiting() {
        let nodes = nodes();
        let mut closures: Vec<_> = (0..3).map(|k| closure(10 + k, 90 + k, 0.0, 8.0)).collect();
        closures.extend((3..6).map(|k| closure(10 + k, 90 + k, 3.0, 8.0)));
        assert_eq!(eligible(&closures, &nodes), [false; 6]);
    }
}
