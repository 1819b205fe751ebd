//! The odometry in doubt: where what is seen contradicts the map for long, the whole map is searched, and where closures disprove the
//! odometry, it is cut: what was driven since is a trajectory of its own.

use super::{Kept, SyncManager};
use flockslam_loop_closure::agreement::agree;
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::comparison::{compared, is_resolved, nearest, old, weakest};
use flockslam_loop_closure::doubt::{PLACE_MIN, disproof, one_place};
use flockslam_loop_closure::finder::{ANYWHERE, QUERY_NODES, SIGHT_M, World};
use flockslam_loop_closure::node::Node;
use flockslam_loop_closure::segment::Segment;
use flockslam_registration::cloud::{Placement, Window};

/// Most segments that a doubtful query is looked for in.
const SEGMENTS_MAX: usize = 40;
/// Once one place is known, only segments that see where the others would be are searched, so many.
const SEGMENTS_NEAR: usize = 6;
/// Where scans before the first closure are looked for: where it puts them. So many in a row may be missed.
const HERE: Window = Window { reach_m: 0.5, turn_rad: 0.1 };
const MISSED_MAX: usize = 3;
/// The map has surfaces where so many points are compared with it.
const LOOKED_MIN: u32 = 50;
/// To carry a robot away takes longer than this, while its wheels stand, nanoseconds.
const PAUSE_MIN_NS: i64 = 3_000_000_000;
/// The odometry is cut at most this far before what speaks against it first, metres.
const CUT_WITHIN_M: f64 = 30.0;
/// Where it is cut must be known this well, metres: what lies between is attached to the one or the other side, and may be attached wrongly.
const CUT_RANGE_MAX_M: f64 = 6.0;

impl SyncManager {
    /// Compares a query with the map around it, looks for it everywhere while the odometry is doubtful, and cuts the odometry where it is
    /// disproved. What robots of a flock have published stays.
    pub(super) fn doubt(&mut self, query: usize, known: usize, first_found: usize) {
        let nodes = &self.odometry.nodes()[..known];
        let node = nodes[query];
        let is_never_cut = self.unpublished.is_some() || node.is_open || node.is_given;
        if is_never_cut || !self.connectivity(known).is_attached(node.trajectory) {
            return;
        }
        let origin = self.doubt.origin().map(|origin| nodes.partition_point(|node| node.sequence < origin));
        if origin.is_some_and(|origin| nodes[origin].trajectory != node.trajectory) {
            self.doubt.forget();
            return;
        }
        let before = origin.unwrap_or(query);
        let is_seen = |(closure, is_inlier): (&Closure, &bool)| {
            *is_inlier && closure.edge.to == query && closure.edge.from < before
        };
        if self.closures[first_found..].iter().zip(&self.is_inlier[first_found..]).any(is_seen) {
            self.doubt.forget();
            return;
        }
        let world = World { nodes, scans: &self.scans, segments: &self.segments, poses: &self.poses };
        let comparison = compared(&world, query, &self.poses[query], before);
        if !self.doubt.judges(&node, comparison) {
            return;
        }
        // What was seen since the first contradiction is looked for too, one query with each new one.
        let earlier = self.doubt.next_unsearched(nodes);
        let mut is_found = false;
        for query in std::iter::once(query).chain(earlier) {
            is_found |= self.search_everywhere(query, before, known);
        }
        if !is_found {
            return;
        }
        let nodes = &self.odometry.nodes()[..known];
        let disproof = disproof(&self.doubt.closures(nodes), nodes, &self.poses);
        if let Some(closures) = disproof {
            self.disprove(&closures, before, known);
        }
    }

    /// Looks for a query in the whole map before node `before`, or, once one place is known, around where that puts it. Gives whether
    /// anything was found.
    fn search_everywhere(&mut self, query: usize, before: usize, known: usize) -> bool {
        let nodes = &self.odometry.nodes()[..known];
        let world = World { nodes, scans: &self.scans, segments: &self.segments, poses: &self.poses };
        let suspected = self.doubt.closures(nodes);
        let place = one_place(&suspected, nodes, &self.poses);
        let mut segments = if place.len() >= PLACE_MIN {
            let at = self.displaced(query, &place);
            nearest(&world, query, &at, before, ANYWHERE.reach_m + SIGHT_M, SEGMENTS_NEAR)
        } else {
            old(&world, query, before).collect()
        };
        if segments.len() > SEGMENTS_MAX {
            let first = self.doubt.searches() * SEGMENTS_MAX % segments.len();
            segments.rotate_left(first);
            segments.truncate(SEGMENTS_MAX);
        }
        let candidates: Vec<(usize, Window)> =
            segments.into_iter().map(|number| (number, ANYWHERE)).collect();
        let searches = self.finder.counts().searches;
        let found = self.finder.find_in(&world, query, QUERY_NODES, &candidates);
        // They are beside the budget of the usual searches.
        self.concluded.searches += self.finder.counts().searches - searches;
        self.doubt.suspects(&found, nodes);
        !found.is_empty()
    }

    /// Where the closures put a node: as the one whose query is nearest along the way says.
    fn displaced(&self, node: usize, closures: &[Closure]) -> Placement {
        let nodes = self.odometry.nodes();
        let nearest = closures.iter().min_by_key(|closure| closure.edge.to.abs_diff(node));
        nearest.map_or(self.poses[node], |closure| {
            let (edge, local) = (&closure.edge, |i: usize| nodes[i].local_pose);
            self.poses[edge.from].compose(edge.motion).compose(local(edge.to).to(local(node)))
        })
    }

    /// Whether what contradicts the map behind a node no longer does where the closures put it.
    fn resolves(&self, closures: &[Closure], cut: usize, before: usize, known: usize) -> bool {
        let nodes = &self.odometry.nodes()[..known];
        let world = World { nodes, scans: &self.scans, segments: &self.segments, poses: &self.poses };
        let behind = |node: &usize| *node >= cut;
        let mut queries: Vec<usize> = self.doubt.contradicting(nodes).into_iter().filter(behind).collect();
        let now = queries.iter().map(|query| compared(&world, *query, &self.poses[*query], before)).sum();
        queries.extend(closures.iter().map(|closure| closure.edge.to));
        queries.sort_unstable();
        queries.dedup();
        let there = |query: &usize| compared(&world, *query, &self.displaced(*query, closures), before);
        let then = queries.iter().map(there).sum();
        is_resolved(now, then)
    }

    /// Cuts the odometry if these closures disprove it, and solves the graph with them.
    fn disprove(&mut self, closures: &[Closure], before: usize, known: usize) {
        let Some(kept) = self.cut_place(closures, known) else { return };
        if !self.resolves(closures, self.first_node(kept), before, known) {
            return;
        }
        self.doubt.forget();
        let cut = self.cut(kept);
        self.is_inlier.extend(closures.iter().map(|_| true));
        self.closures.extend(closures);
        self.solve(known);
        self.unsolved = false;
        let node = self.odometry.nodes()[cut];
        tracing::warn!(
            scan = node.sequence,
            trajectory = node.trajectory,
            closures = closures.len(),
            "the odometry was wrong: a trajectory begins where the map shows it"
        );
    }

    /// The first of the kept scans behind the place where the odometry is cut: between the last closure that speaks for the odometry and
    /// what speaks against it first, a query that contradicts the map or a node that is found where the closures put it; where the robot
    /// stood there, or else where scans contradict each other most.
    fn cut_place(&mut self, closures: &[Closure], known: usize) -> Option<usize> {
        let (disproved, nodes) = (closures[0].edge.to, &self.odometry.nodes()[..known]);
        if !self.odometry.can_be_cut(disproved) {
            return None;
        }
        let speaks_for_odometry = |closure: &&Closure| {
            let agrees = |other: &Closure| {
                other.edge.to != closure.edge.to && agree(closure, other, nodes) == Some(true)
            };
            closure.edge.to < disproved && self.closures.iter().any(agrees)
        };
        let held = self.closures.iter().filter(speaks_for_odometry).map(|closure| closure.edge.to).max();
        let contradicting = self.doubt.contradicting(nodes).into_iter();
        let first_contradicting = contradicting.filter(|query| Some(*query) > held).min();
        // A query sees what nodes behind it see too.
        let last = first_contradicting.map_or(disproved, |query| (query + QUERY_NODES).min(disproved));
        let earliest_m = nodes[last].travel_m - CUT_WITHIN_M;
        let is_before = |node: &Node| node.trajectory < nodes[last].trajectory || node.travel_m < earliest_m;
        let first = held.unwrap_or(0).max(nodes.partition_point(is_before));
        let (found, missed) = self.first_found(first, closures, known);
        let (first, last) = missed.map_or((first, last.min(found)), |missed| (first.max(missed), found));
        let nodes = &self.odometry.nodes()[..known];
        if first >= last || nodes[last].travel_m - nodes[first].travel_m > CUT_RANGE_MAX_M {
            return None;
        }
        let [start, end] = [first, last].map(|node| self.kept.partition_point(|kept| kept.node < node));
        let between = &self.kept[start..=end];
        let scan = |kept: &Kept| (kept.scan, self.records[kept.record].odom);
        let seen: Vec<(usize, Placement)> = between.iter().map(scan).collect();
        let stamps = between.iter().map(|kept| self.records[kept.record].stamp_ns);
        Some(start + pause(stamps).unwrap_or_else(|| weakest(&self.scans, &seen)))
    }

    /// The first node at or behind a kept scan.
    fn first_node(&self, kept: usize) -> usize {
        let Kept { node, is_node, .. } = self.kept[kept];
        if is_node { node } else { node + 1 }
    }

    /// The first node behind `first` whose scan is found where the first of these closures put it, as nearly all up to that one are; and a
    /// node before it whose scan is not found there although the map has surfaces there: the robot was elsewhere.
    fn first_found(&mut self, first: usize, closures: &[Closure], known: usize) -> (usize, Option<usize>) {
        let nodes = &self.odometry.nodes()[..known];
        let edge = closures[0].edge;
        let Some(number) = self.segments.iter().position(|s| s.nodes.contains(&edge.from)) else {
            return (edge.to, None);
        };
        let (mut found, mut missed) = (edge.to, 0);
        let mut is_elsewhere = true;
        let mut poses = self.poses.clone();
        for node in (first + 1..edge.to).rev() {
            poses[node] = self.displaced(node, closures);
            let world = World { nodes, scans: &self.scans, segments: &self.segments, poses: &poses };
            let is_found = !self.finder.find_in(&world, node, 0, &[(number, HERE)]).is_empty();
            if is_found {
                (found, missed, is_elsewhere) = (node, 0, true);
                continue;
            }
            missed += 1;
            is_elsewhere &= compared(&world, node, &poses[node], edge.to).looked >= LOOKED_MIN;
            if missed > MISSED_MAX {
                return (found, is_elsewhere.then_some(node));
            }
        }
        (found, None)
    }

    /// Makes what was driven from one of the kept scans on a trajectory of its own. Gives its first node.
    fn cut(&mut self, kept: usize) -> usize {
        let (node, record) = (self.first_node(kept), self.kept[kept].record);
        self.kept[kept..].iter_mut().for_each(|kept| kept.node = kept.node.max(node));
        let before = self.odometry.nodes()[node].trajectory;
        self.odometry.cut(node);
        for later in &mut self.records[record..] {
            later.trajectory += 1;
        }
        self.entries.begin(before + 1);
        self.driven.split(before, self.records[record..].iter().filter(|r| r.trajectory == before + 1));
        // A submap with scans of both sides shows what is true of neither.
        let submap = |at: usize| self.records.get(at).map(|record| record.submap);
        if let Some(torn) = submap(record).filter(|torn| record > 0 && submap(record - 1) == Some(*torn)) {
            self.leave_out(torn);
        }
        if let Some(number) = self.segments.iter().position(|s| s.nodes.start < node && node < s.nodes.end) {
            let nodes = self.segments[number].nodes.clone();
            self.segments[number] = Segment::new(nodes.start..node);
            self.segments.insert(number + 1, Segment::new(node..nodes.end));
            self.next_frozen += usize::from(number < self.next_frozen);
        }
        node
    }
}

/// The number of the stamp behind the longest pause between these, if one is long enough to carry a robot.
fn pause(stamps_ns: impl Iterator<Item = i64> + Clone) -> Option<usize> {
    let pauses =
        stamps_ns.clone().zip(stamps_ns.skip(1)).map(|(before, behind)| behind.saturating_sub(before));
    let longest = pauses.enumerate().fold((PAUSE_MIN_NS, None), |most, (before, pause_ns)| {
        if pause_ns > most.0 { (pause_ns, Some(before + 1)) } else { most }
    });
    longest.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_is_carried_during_the_longest_pause() {
        let seconds = |stamps: &[i64]| pause(stamps.iter().map(|stamp| stamp * 1_000_000_000));
        assert_eq!(seconds(&[0, 1, 2, 12, 13, 21, 22]), Some(3));
        assert_eq!(seconds(&[0, 1, 0, 2, 3]), None);
        assert_eq!(seconds(&[5]), None);
    }
}
