//! The pose graph of all robots: takes a collection of records, gives nodes, edges, segments and closures, in an order that follows from the records
//! alone.

use super::consistency::consistent;
use super::inspection::Inspected;
use flockslam_loop_closure::agreement::eligible;
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::node::{BROKEN_M, Node};
use flockslam_loop_closure::scans::ScanStore;
use flockslam_loop_closure::segment::Segment;
use flockslam_pose_graph::Edge;
use flockslam_records::{Collection, Constraint, Content, NodeName, RecordedNode, RobotId, Stretch};
use flockslam_registration::cloud::{PackedPoint, Placement};
use std::collections::BTreeSet;
use std::ops::Range;

/// Information where nothing is known: just enough that the graph hangs together.
const UNKNOWN: [f64; 6] = [1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-4];

/// One log's part of the graph.
#[derive(Clone, Debug)]
pub struct Log {
    /// Whose it is.
    pub robot: RobotId,
    /// Which of its logs.
    pub epoch: u64,
    /// Its nodes.
    pub nodes: Range<usize>,
}

/// The graph that a collection of records describes: the trajectories of all robots one behind the other, in the order of their names, with
/// nothing known between them but what constraints say.
pub struct FlockGraph {
    pub(super) logs: Vec<Log>,
    pub(super) nodes: Vec<Node>,
    /// By node: the submap that its scan is in, and the sequence of its scan.
    pub(super) scanned: Vec<Scanned>,
    pub(super) edges: Vec<Edge>,
    pub(super) scans: ScanStore,
    pub(super) segments: Vec<Segment>,
    pub(super) closures: Vec<Closure>,
    /// By trajectory: its log.
    pub(super) owners: Vec<u32>,
}

/// What else is known of a node.
#[derive(Clone, Copy, Debug)]
pub struct Scanned {
    /// Sequence of its scan in its log.
    pub sequence: u64,
    /// Number of the submap that its scan entered.
    pub submap: u32,
}

impl FlockGraph {
    /// The graph of all records that hold.
    pub fn new(collection: &Collection) -> Self {
        let mut graph = Self {
            logs: Vec::new(),
            nodes: Vec::new(),
            scanned: Vec::new(),
            edges: Vec::new(),
            scans: ScanStore::default(),
            segments: Vec::new(),
            closures: Vec::new(),
            owners: Vec::new(),
        };
        graph.add_odometry(collection);
        graph.segments = Segment::cut(&graph.nodes, 0);
        let rest = graph.segments.last().map_or(0, |s| s.nodes.end)..graph.nodes.len();
        // The end of each robot's way counts too, short as it may be.
        if rest.len() > 1 {
            graph.segments.push(Segment::new(rest));
        }
        for record in collection.records() {
            if let Content::Constraints(constraints) = &record.content {
                let closures: Vec<Closure> = constraints.iter().filter_map(|c| graph.closure(c)).collect();
                graph.closures.extend(closures);
            }
        }
        graph
    }

    fn add_odometry(&mut self, collection: &Collection) {
        let mut stretches: Vec<(&RobotId, u64, &Stretch)> = Vec::new();
        for record in collection.records() {
            if let Content::Stretch(stretch) = &record.content
                && !stretch.nodes.is_empty()
            {
                stretches.push((&record.name.robot, record.name.epoch, stretch));
            }
        }
        stretches.sort_by_key(|(robot, epoch, stretch)| (*robot, *epoch, stretch.nodes[0].sequence));
        for log in stretches.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let first = self.nodes.len();
            let mut last: Option<(u64, u32)> = None;
            for (robot, epoch, stretch) in log {
                for (place, node) in stretch.nodes.iter().enumerate() {
                    // Of two records of one scan the first counts.
                    if last.is_some_and(|(last, _)| node.sequence <= last) {
                        continue;
                    }
                    let before =
                        if place == 0 { stretch.previous } else { Some(stretch.nodes[place - 1].sequence) };
                    let follows = last.is_some() && last == before.map(|before| (before, stretch.trajectory));
                    self.add_node(node, follows, unique(robot, *epoch, node.sequence));
                    last = Some((node.sequence, stretch.trajectory));
                }
            }
            let (robot, epoch, nodes) = (log[0].0.clone(), log[0].1, first..self.nodes.len());
            self.owners.resize(
                self.nodes.last().map_or(0, |node| node.trajectory as usize + 1),
                self.logs.len() as u32,
            );
            self.logs.push(Log { robot, epoch, nodes });
        }
    }

    fn add_node(&mut self, new: &RecordedNode, follows: bool, sequence: u64) {
        let points = new.points.iter().map(|&[x_mm, y_mm]| PackedPoint { x_mm, y_mm });
        let scan = self.scans.keep_points(points);
        let odom = Placement::from(new.odom_from_base);
        let to = self.nodes.len();
        let node = match self.nodes.last() {
            Some(last) if follows => {
                let motion = Placement::from(new.motion);
                let information = new.information.map(f64::from);
                self.edges.push(Edge { from: to - 1, to, motion, information });
                let local_pose = last.local_pose.compose(motion);
                let way_m = local_pose.distance_m(&last.local_pose);
                let drift_bound_m = last.drift_bound_m + way_m + f64::from(new.drift_bound_m);
                Node {
                    local_pose,
                    start: local_pose,
                    travel_m: last.travel_m + way_m,
                    drift_bound_m,
                    scan,
                    sequence,
                    odom,
                    ..*last
                }
            }
            Some(last) => {
                let motion = last.local_pose.to(odom);
                self.edges.push(Edge { from: to - 1, to, motion, information: UNKNOWN });
                Node {
                    local_pose: odom,
                    start: odom,
                    travel_m: last.travel_m,
                    drift_bound_m: last.drift_bound_m + BROKEN_M,
                    trajectory: last.trajectory + 1,
                    scan,
                    sequence,
                    odom,
                    is_open: false,
                    is_given: false,
                }
            }
            None => Node {
                local_pose: odom,
                start: odom,
                travel_m: 0.0,
                drift_bound_m: 0.0,
                trajectory: 0,
                scan,
                sequence,
                odom,
                is_open: false,
                is_given: false,
            },
        };
        self.nodes.push(node);
        self.scanned.push(Scanned { sequence: new.sequence, submap: new.submap });
    }

    /// The closure that a constraint describes, once both of its nodes are known.
    fn closure(&self, constraint: &Constraint) -> Option<Closure> {
        let (from, to) = (self.find(&constraint.from)?, self.find(&constraint.to)?);
        let edge = Edge {
            from,
            to,
            motion: constraint.motion.into(),
            information: constraint.information.map(f64::from),
        };
        let (reach_m, shift_m) = (f64::from(constraint.reach_m), f64::from(constraint.shift_m));
        let mut closure = Closure { edge, reach_m, shift_m };
        // All closures between two robots in one direction, from either robot: only then they can be compared.
        if self.is_across(&closure) && from > to {
            closure.edge = closure.edge.reversed();
        }
        Some(closure)
    }

    /// By closure: whether it may act, when nothing is held of those `denied`. A robot's own are checked as the robot itself checks
    /// them; those between robots, of which any may be a lie, need more.
    pub(super) fn eligible(&self, denied: &BTreeSet<usize>, inspected: &mut Inspected) -> Vec<bool> {
        let across: Vec<bool> = self.closures.iter().map(|closure| self.is_across(closure)).collect();
        let checked: Vec<bool> =
            across.iter().enumerate().map(|(i, across)| *across && !denied.contains(&i)).collect();
        let own = eligible(&self.closures, &self.nodes);
        let mut stands = |group: &[usize]| self.stands(group, inspected);
        let consistent = consistent(&self.closures, &self.nodes, &checked, &mut stands);
        let each = across.iter().zip(own).zip(consistent);
        each.map(|((across, own), consistent)| if *across { consistent } else { own }).collect()
    }

    /// Of these closures those that are outliers if these alone are left: between robots, what the others have confirmed is
    /// confirmed no more.
    pub(super) fn unconfirmed(&self, is_inlier: &[bool]) -> Vec<usize> {
        let counts = |i: usize| is_inlier[i] && self.is_across(&self.closures[i]);
        let across: Vec<bool> = (0..self.closures.len()).map(counts).collect();
        // What the robots have seen has been looked at.
        let consistent = consistent(&self.closures, &self.nodes, &across, &mut |_| true);
        (0..self.closures.len()).filter(|i| across[*i] && !consistent[*i]).collect()
    }

    /// Points of a node's scan, in its robot's frame.
    pub fn points(&self, node: usize) -> &[PackedPoint] {
        self.scans.points(self.nodes[node].scan)
    }

    /// Whether a closure connects two robots.
    pub(super) fn is_across(&self, closure: &Closure) -> bool {
        self.owner(closure.edge.from) != self.owner(closure.edge.to)
    }

    /// The log of a node.
    pub(super) fn owner(&self, node: usize) -> u32 {
        self.owners[self.nodes[node].trajectory as usize]
    }

    /// The node of this name.
    pub(super) fn find(&self, name: &NodeName) -> Option<usize> {
        let log = self.logs.binary_search_by(|log| (&log.robot, log.epoch).cmp(&(&name.robot, name.epoch)));
        let nodes = self.logs[log.ok()?].nodes.clone();
        let place = self.scanned[nodes.clone()].binary_search_by_key(&name.sequence, |s| s.sequence);
        place.ok().map(|place| nodes.start + place)
    }

    /// How a node is called.
    pub(super) fn name(&self, node: usize) -> NodeName {
        let log = &self.logs[self.owner(node) as usize];
        NodeName { robot: log.robot.clone(), epoch: log.epoch, sequence: self.scanned[node].sequence }
    }

    /// Adds a closure between robots that has just been found.
    pub(super) fn add_across(&mut self, constraint: &Constraint) {
        let closure = self.closure(constraint);
        self.closures.extend(closure);
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there is no node yet.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }
}

/// A number that no other node has (but for chance): a field made for one must not be taken for another's.
fn unique(robot: &RobotId, epoch: u64, sequence: u64) -> u64 {
    let [a, b, c, d, e, f, g, h, ..] = *robot.public_key();
    let mut mixed = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
    for word in [epoch, sequence] {
        // A round of SplitMix64.
        mixed = (mixed ^ word).wrapping_add(0x9e37_79b9_7f4a_7c15);
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^= mixed >> 31;
    }
    mixed
}
