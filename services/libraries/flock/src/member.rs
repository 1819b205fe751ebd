//! One robot's state in the flock: its key, the records that it has, its search; messages in, messages and records out.

use super::inspection::Inspected;
use super::inter_robot_search::Search;
use super::{Findings, FlockGraph};
use flockslam_geometry::Pose;
use flockslam_records::{
    CONSTRAINTS_MAX, Collection, Constraint, Content, Limits, Message, NodeName, Presence, Record,
    RecordError, RobotId, RobotKey, SubmapRecord,
};
use std::cell::{RefCell, RefMut};
use std::sync::Arc;

/// The state of one robot in its flock, and the messages that it sends.
///
/// A pure function of its calls: findings of its own back end and messages of others in, records and messages out.
///
/// ```
/// use flockslam_geometry::Pose;
/// use flockslam_records::{Descriptor, Limits, RecordedNode, RobotKey, Stretch};
/// use flockslam_flock::{Flock, Findings};
///
/// let robot = |key| Flock::new(key, 1, Limits::default());
/// let (mut a, mut b) = (robot(RobotKey::of_replay("a")?), robot(RobotKey::of_replay("b")?));
/// // Robot a has driven a metre.
/// let node = |sequence: u8| RecordedNode {
///     sequence: sequence.into(),
///     submap: 0,
///     odom_from_base: Pose::new(sequence.into(), 0.0, 0.0),
///     motion: Pose::new(1.0, 0.0, 0.0),
///     information: [400.0, 0.0, 0.0, 400.0, 0.0, 1e4],
///     drift_bound_m: 0.0,
///     points: vec![[2000, 0]],
/// };
/// let (descriptor, nodes) = (Descriptor::default(), vec![node(0), node(1)]);
/// let stretch = Stretch { trajectory: 0, previous: None, descriptor, nodes };
/// a.publish(&Findings { stretches: vec![stretch], loops: Vec::new() })?;
/// // Robot b sends its vector, and is sent the missing records, here at most 20 kB.
/// for answer in a.answer(&b.have(), 20_000) {
///     b.answer(&answer, 0);
/// }
/// // Who knows the same records has the same solution.
/// assert_eq!(b.solution(false), a.solution(false));
/// assert_eq!(b.solution(false).members(), [a.robot()]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Flock {
    key: RobotKey,
    epoch: u64,
    collection: Collection,
    search: Search,
    inspected: RefCell<Inspected>,
}

impl Flock {
    /// A robot without records. An epoch is never used again after a log has been lost.
    pub fn new(key: RobotKey, epoch: u64, limits: Limits) -> Self {
        let search = Search::new();
        Self { key, epoch, collection: Collection::new(limits), search, inspected: RefCell::default() }
    }

    /// The robot.
    pub fn robot(&self) -> &RobotId {
        self.key.id()
    }

    /// All that it knows, its own records among them.
    pub fn collection(&self) -> &Collection {
        &self.collection
    }

    /// The same, to ban or to trust.
    pub fn collection_mut(&mut self) -> &mut Collection {
        &mut self.collection
    }

    /// Stored results for groups of closures.
    pub(super) fn inspected(&self) -> RefMut<'_, Inspected> {
        self.inspected.borrow_mut()
    }

    /// Branch-and-bound searches so far.
    pub fn searches(&self) -> u64 {
        self.search.searches()
    }

    /// Makes a record: gives its bytes, which must be stored before the record is sent.
    ///
    /// # Errors
    /// When the content is too large for a record.
    pub fn record(&mut self, content: &Content) -> Result<Arc<[u8]>, RecordError> {
        let number = self.collection.next_number(self.key.id(), self.epoch);
        let record = Record::new(&self.key, self.epoch, number, content)?;
        let bytes = Arc::clone(record.bytes());
        self.collection.insert(record);
        Ok(bytes)
    }

    /// Says what its own back end has found out.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn publish(&mut self, findings: &Findings) -> Result<Vec<Arc<[u8]>>, RecordError> {
        let mut records = Vec::new();
        for stretch in &findings.stretches {
            records.push(self.record(&Content::Stretch(stretch.clone()))?);
        }
        let node = |sequence| NodeName { robot: self.key.id().clone(), epoch: self.epoch, sequence };
        let constraint = |own: &super::OwnLoop| Constraint {
            from: node(own.from),
            to: node(own.to),
            motion: own.closure.edge.motion.pose(),
            information: own.closure.edge.information.map(|v| v as f32),
            reach_m: own.closure.reach_m as f32,
            shift_m: own.closure.shift_m as f32,
        };
        let constraints: Vec<Constraint> = findings.loops.iter().map(constraint).collect();
        records.extend(self.record_constraints(&constraints)?);
        Ok(records)
    }

    /// Makes records of new constraints, as few as possible.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn record_constraints(&mut self, constraints: &[Constraint]) -> Result<Vec<Arc<[u8]>>, RecordError> {
        let records = constraints.chunks(CONSTRAINTS_MAX);
        records.map(|some| self.record(&Content::Constraints(some.to_vec()))).collect()
    }

    /// Makes a record of the evidence of a closed submap.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn record_submap(&mut self, submap: &flockslam_evidence::Submap) -> Result<Arc<[u8]>, RecordError> {
        self.record(&Content::Submap(SubmapRecord::of(&submap.coarsened())))
    }

    /// Takes in a message of another robot and gives what to answer, with records for at most so many bytes.
    pub fn answer(&mut self, message: &Message, budget_bytes: usize) -> Vec<Message> {
        self.collection.answer(message, budget_bytes)
    }

    /// Its pose, as a message to others.
    pub fn here(&self, sequence: u64, submap: u32, odom_from_base: Pose) -> Message {
        Message::Here(Presence::sign(&self.key, self.epoch, sequence, submap, odom_from_base))
    }

    /// Its version vector, as a message to others.
    pub fn have(&self) -> Message {
        Message::Have(self.collection.vector())
    }

    /// Searches for inter-robot closures, with at most about so many searches, and publishes those that it has found.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn search(&mut self, searches_max: u64) -> Result<Vec<Arc<[u8]>>, RecordError> {
        let found = self.find(searches_max);
        self.record_constraints(&found)
    }

    /// As [`Self::search`], without publishing: for callers that have some of it already.
    pub fn find(&mut self, searches_max: u64) -> Vec<Constraint> {
        let mut graph = FlockGraph::new(&self.collection);
        self.search.run(&mut graph, self.key.id(), searches_max, self.inspected.get_mut())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OwnLoop;
    use flockslam_loop_closure::closure::Closure;
    use flockslam_loop_closure::{finder, open_finder};
    use flockslam_pose_graph::Edge;
    use flockslam_registration::cloud::Placement;

    /// A record that the robot's own log refuses would end its sync-manager.
    #[test]
    fn loops_of_each_finder_are_published_also_when_their_points_are_exact() {
        for (sigma_m, sigma_rad) in [finder::SLACK, open_finder::SLACK] {
            let (position, heading) = (1.0 / (sigma_m * sigma_m), 1.0 / (sigma_rad * sigma_rad));
            let information = [position, 0.0, 0.0, position, 0.0, heading];
            let edge = Edge { from: 0, to: 1, motion: Placement::IDENTITY, information };
            let closure = Closure { edge, reach_m: 1.0, shift_m: 0.0 };
            let loops = vec![OwnLoop { from: 0, to: 5, closure }];
            let mut robot = Flock::new(RobotKey::of_replay("a").unwrap(), 1, Limits::default());
            let records = robot.publish(&Findings { stretches: Vec::new(), loops });
            assert_eq!(records.unwrap().len(), 1);
        }
    }
}
