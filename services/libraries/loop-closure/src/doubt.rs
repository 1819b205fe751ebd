//! Doubt in the odometry: what a robot sees may contradict the map where its pose says that it is, and stand elsewhere in it. Takes
//! comparisons of queries with older segments, gives when the odometry is doubtful, and closures that together disprove it.

use crate::agreement::agree;
use crate::closure::Closure;
use crate::comparison::Comparison;
use crate::finder::window;
use crate::node::Node;
use flockslam_registration::cloud::Placement;

/// Travel on which what is seen must contradict the map before all of it is searched, metres. A robot that comes back to its map off by
/// its drift contradicts it too, until the loop is closed: for less than this on the public logs and in the simulated worlds.
pub const DOUBTFUL_M: f64 = 20.0;
/// A query stands for this much travel at most, metres.
const STEP_M: f64 = 3.0;
/// Without a contradiction for so long the robot is off the map, and a few contradictions before are forgotten, metres.
const FORGOTTEN_M: f64 = 30.0;
/// Queries that are looked for everywhere in one doubt: bounds its work.
const SEARCHES_MAX: usize = 60;
/// Closures of one place that agree, at least.
pub const PLACE_MIN: usize = 3;
/// Places of the map that must be found, how far they lie apart, and travel from the first query to the last, metres: alike places repeat
/// over less, and repeated ones do not all lie where the odometry between them says.
const PLACES_MIN: usize = 2;
const PLACES_APART_M: f64 = 10.0;
const EXTENT_MIN_M: f64 = 20.0;

/// A closure found while the odometry was doubtful, with the sequences of its nodes: numbers of nodes change.
#[derive(Clone, Copy, Debug)]
struct Suspicion {
    from: u64,
    to: u64,
    closure: Closure,
}

/// Whether the odometry is doubtful since some query, and what speaks against it.
#[derive(Clone, Debug, Default)]
pub struct Doubt {
    /// Sequence of the first query that contradicted the map.
    origin: Option<u64>,
    /// Travel on which queries contradicted it, at the last query, and at the last one that did, metres.
    contradicted_m: f64,
    at_m: f64,
    contradicted_at_m: f64,
    /// Queries that contradicted it, by sequence.
    contradicting: Vec<u64>,
    /// Those of them that were not looked for yet.
    unsearched: Vec<u64>,
    searches: usize,
    suspicions: Vec<Suspicion>,
}

impl Doubt {
    /// Sequence of the first query that contradicted the map.
    pub fn origin(&self) -> Option<u64> {
        self.origin
    }

    /// Takes what the map before the doubt says of the next query. Gives whether the odometry is so doubtful that the query is to be
    /// looked for everywhere.
    pub fn judges(&mut self, query: &Node, comparison: Comparison) -> bool {
        let step_m = (query.travel_m - self.at_m).clamp(0.0, STEP_M);
        self.at_m = query.travel_m;
        if comparison.confirms() {
            self.forget();
        } else if comparison.contradicts() {
            self.origin.get_or_insert(query.sequence);
            self.contradicted_m += step_m;
            self.contradicted_at_m = query.travel_m;
            self.contradicting.push(query.sequence);
            if self.contradicted_m < DOUBTFUL_M {
                self.unsearched.push(query.sequence);
            }
        } else if self.contradicted_m < DOUBTFUL_M && query.travel_m - self.contradicted_at_m > FORGOTTEN_M {
            self.forget();
        }
        let is_doubtful = self.contradicted_m >= DOUBTFUL_M && self.searches < SEARCHES_MAX;
        self.searches += usize::from(is_doubtful);
        is_doubtful
    }

    /// The newest query from before the doubt was certain that was not looked for yet: it is looked for now.
    pub fn next_unsearched(&mut self, nodes: &[Node]) -> Option<usize> {
        let sequence = self.unsearched.pop()?;
        nodes.binary_search_by_key(&sequence, |node| node.sequence).ok()
    }

    /// Searches so far.
    pub fn searches(&self) -> usize {
        self.searches
    }

    /// Begins anew.
    pub fn forget(&mut self) {
        *self = Self { at_m: self.at_m, ..Self::default() };
    }

    /// Notes closures that were found anywhere.
    pub fn suspects(&mut self, found: &[Closure], nodes: &[Node]) {
        self.suspicions.extend(found.iter().map(|closure| Suspicion {
            from: nodes[closure.edge.from].sequence,
            to: nodes[closure.edge.to].sequence,
            closure: *closure,
        }));
    }

    /// The closures found anywhere whose nodes are still there, between these.
    pub fn closures(&self, nodes: &[Node]) -> Vec<Closure> {
        let number = |sequence: u64| nodes.binary_search_by_key(&sequence, |node| node.sequence).ok();
        let renamed = |suspicion: &Suspicion| {
            let mut closure = suspicion.closure;
            (closure.edge.from, closure.edge.to) = (number(suspicion.from)?, number(suspicion.to)?);
            Some(closure)
        };
        self.suspicions.iter().filter_map(renamed).collect()
    }

    /// The queries that contradicted the map and are still there.
    pub fn contradicting(&self, nodes: &[Node]) -> Vec<usize> {
        let number = |sequence: &u64| nodes.binary_search_by_key(sequence, |node| node.sequence).ok();
        self.contradicting.iter().filter_map(number).collect()
    }
}

/// The largest group of these closures that agree on one place of the map, in order, if there are enough.
pub fn one_place(closures: &[Closure], nodes: &[Node], poses: &[Placement]) -> Vec<Closure> {
    let places = places(closures, nodes, poses);
    places
        .into_iter()
        .reduce(|best, place| if place.len() > best.len() { place } else { best })
        .unwrap_or_default()
}

/// The closures that together disprove the odometry, in the order of their queries: of several places far apart in the map, each with
/// enough that agree, all displaced by more than the odometry may have drifted, and in line with the odometry between them.
pub fn disproof(closures: &[Closure], nodes: &[Node], poses: &[Placement]) -> Option<Vec<Closure>> {
    let places = places(closures, nodes, poses);
    let in_line = |seed: usize| -> Vec<usize> {
        (0..places.len())
            .filter(|k| *k == seed || is_in_line(&places[seed][0], &places[*k][0], nodes))
            .collect()
    };
    let count = |group: &[usize]| group.iter().map(|k| places[*k].len()).sum::<usize>();
    let groups = (0..places.len()).map(in_line);
    let best = groups.reduce(|best, group| if count(&group) > count(&best) { group } else { best })?;
    let rivals: usize = (0..places.len()).filter(|k| !best.contains(k)).map(|k| places[k].len()).sum();
    let mut apart: Vec<Placement> = Vec::new();
    for k in &best {
        let at = poses[places[*k][0].edge.from];
        if apart.iter().all(|other| other.distance_m(&at) >= PLACES_APART_M) {
            apart.push(at);
        }
    }
    let mut supporting: Vec<Closure> = best.iter().flat_map(|k| places[*k].iter().copied()).collect();
    supporting.sort_by_key(|closure| (closure.edge.to, closure.edge.from));
    let travel_m = |closure: Option<&Closure>| closure.map_or(0.0, |c| nodes[c.edge.to].travel_m);
    let extent_m = travel_m(supporting.last()) - travel_m(supporting.first());
    let holds = apart.len() >= PLACES_MIN && extent_m >= EXTENT_MIN_M && 2 * rivals <= supporting.len();
    holds.then_some(supporting)
}

/// Groups of displaced closures that agree with each other, directly or over others, of enough each.
fn places(closures: &[Closure], nodes: &[Node], poses: &[Placement]) -> Vec<Vec<Closure>> {
    let mut groups: Vec<Vec<Closure>> = Vec::new();
    for closure in closures.iter().filter(|closure| is_displaced(closure, nodes, poses)) {
        let agrees =
            |group: &Vec<Closure>| group.iter().any(|other| agree(closure, other, nodes) == Some(true));
        let (joined, rest): (Vec<_>, Vec<_>) = groups.into_iter().partition(agrees);
        let mut group: Vec<Closure> = joined.into_iter().flatten().collect();
        group.push(*closure);
        groups = rest;
        groups.push(group);
    }
    let queries = |group: &Vec<Closure>| {
        let mut queries: Vec<usize> = group.iter().map(|closure| closure.edge.to).collect();
        queries.sort_unstable();
        queries.dedup();
        queries.len()
    };
    groups.retain(|group| queries(group) >= PLACE_MIN);
    groups
}

/// Whether a closure puts its query farther from where it is taken to be than the odometry may have drifted.
fn is_displaced(closure: &Closure, nodes: &[Node], poses: &[Placement]) -> bool {
    let edge = &closure.edge;
    let there = poses[edge.from].compose(edge.motion);
    let way_m = (nodes[edge.to].drift_bound_m - nodes[edge.from].drift_bound_m).abs();
    there.distance_m(&poses[edge.to]) > window(way_m).reach_m
}

/// Whether the odometry between two closures, however long, leads from the one to the other.
fn is_in_line(a: &Closure, b: &Closure, nodes: &[Node]) -> bool {
    let between = |i: usize, k: usize| (nodes[i].drift_bound_m - nodes[k].drift_bound_m).abs();
    let driven = |i: usize, k: usize| nodes[i].local_pose.to(nodes[k].local_pose);
    let around = a.edge.motion.compose(driven(a.edge.to, b.edge.to));
    let along = driven(a.edge.from, b.edge.from).compose(b.edge.motion);
    let within = window(between(a.edge.from, b.edge.from) + between(a.edge.to, b.edge.to));
    along.distance_m(&around) <= within.reach_m && along.turn_rad(&around) <= within.turn_rad
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_pose_graph::Edge;

    fn node(k: usize, at: Placement) -> Node {
        Node {
            scan: k,
            sequence: 10 * k as u64,
            odom: at,
            local_pose: at,
            start: at,
            travel_m: k as f64,
            drift_bound_m: k as f64,
            trajectory: 0,
            is_open: false,
            is_given: false,
        }
    }

    /// A straight drive of 200 m.
    fn drive() -> (Vec<Node>, Vec<Placement>) {
        let nodes: Vec<Node> = (0..200).map(|k| node(k, Placement::new(k as f64, 0.0, 0.0))).collect();
        let poses = nodes.iter().map(|node| node.local_pose).collect();
        (nodes, poses)
    }

    /// Node `to` seen from node `from`, if the truth is so much farther along the drive than the odometry says.
    fn closure(from: usize, to: usize, farther_m: f64) -> Closure {
        let motion = Placement::new(to as f64 + farther_m - from as f64, 0.0, 0.0);
        let edge = Edge { from, to, motion, information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] };
        Closure { edge, reach_m: 14.0, shift_m: 0.0 }
    }

    fn group(from: usize, to: usize, farther_m: f64) -> Vec<Closure> {
        (0..3).map(|k| closure(from + 2 * k, to + 2 * k, farther_m)).collect()
    }

    fn comparison(through: u32, on: u32) -> Comparison {
        Comparison { looked: 100, through, on }
    }

    #[test]
    fn is_doubtful_where_the_map_is_contradicted_for_long() {
        let (nodes, _) = drive();
        let mut doubt = Doubt::default();
        // A loop that is closed after 15 m, then two rows of contradictions apart from each other.
        let says = |k: usize| match k {
            20..35 | 100..110 | 150..175 => comparison(70, 10),
            35 => comparison(5, 90),
            _ => Comparison::default(),
        };
        let doubtful: Vec<usize> = (0..200).filter(|&k| doubt.judges(&nodes[k], says(k))).collect();
        assert_eq!((doubtful[0], doubtful.len()), (169, 31));
        assert_eq!(doubt.origin(), Some(1500));
        assert_eq!(doubt.contradicting(&nodes).len(), 25);
        assert!(!doubt.judges(&nodes[199], comparison(5, 90)), "the map confirms it");
        assert_eq!(doubt.origin(), None);
    }

    #[test]
    fn does_not_search_for_ever() {
        let (nodes, _) = drive();
        let mut doubt = Doubt::default();
        let doubtful = nodes.iter().filter(|node| doubt.judges(node, comparison(70, 10))).count();
        assert_eq!(doubtful, SEARCHES_MAX);
    }

    #[test]
    fn two_places_in_line_disprove_the_odometry() {
        let (nodes, poses) = drive();
        let mut closures = group(20, 120, -80.0);
        assert_eq!(disproof(&closures, &nodes, &poses), None, "one place may look like another");
        assert_eq!(one_place(&closures, &nodes, &poses).len(), 3);
        closures.extend(group(60, 160, -80.0));
        let supporting = disproof(&closures, &nodes, &poses).unwrap();
        assert_eq!(supporting.len(), 6);
        assert_eq!(supporting[0].edge.to, 120);
        // Half as many that say something else.
        closures.extend(group(40, 140, -50.0));
        assert!(disproof(&closures, &nodes, &poses).is_some());
        closures.push(closure(46, 146, -50.0));
        assert_eq!(disproof(&closures, &nodes, &poses), None);
    }

    #[test]
    fn places_out_of_line_and_drift_disprove_nothing() {
        let (nodes, poses) = drive();
        let out_of_line = [group(20, 120, -80.0), group(60, 160, -95.0)].concat();
        assert_eq!(disproof(&out_of_line, &nodes, &poses), None);
        let drift = [group(20, 120, -5.0), group(60, 160, -5.0)].concat();
        assert_eq!(disproof(&drift, &nodes, &poses), None);
        // The same place of the map twice.
        let same = [group(20, 120, -80.0), group(22, 150, -108.0)].concat();
        assert_eq!(disproof(&same, &nodes, &poses), None);
    }
}
