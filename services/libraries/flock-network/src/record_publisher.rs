//! The robot's own log of records: writes what the back end finds to a file, then into the collection, and each thing once only, also after a
//! restart.

use super::drops::{Dropped, Drops};
use super::identity::Identity;
use crate::settings::FlockSettings;
use flockslam_evidence::{Submap, TILE_SIDE, TileKey};
use flockslam_flock::{Findings, Flock, OwnLoop};
use flockslam_records::{
    Clearance, Constraint, Content, Limits, Message, NodeName, Outcome, Record, RecordError, RobotId,
    RobotKey,
};
use flockslam_results::flock_files::RecordLog;
use flockslam_stage::StageError;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// Epoch of a replay.
const FIRST_EPOCH: u64 = 1;

/// Publishes to the flock what this robot finds out, and keeps it in a file before anybody else receives it, as well as what it receives.
///
/// Published findings are not published again: a process that takes over, or is started again, finds the same.
pub struct RecordPublisher {
    flock: Flock,
    epoch: u64,
    log: RecordLog,
    published: Published,
}

/// The records that this robot has published in its present epoch.
#[derive(Default)]
struct Published {
    /// Sequence of the last node.
    last: Option<u64>,
    /// Loops by the nodes that they connect.
    loops: BTreeSet<(u64, u64)>,
    /// What a predecessor has measured between this robot and others: this process finds it again.
    across: BTreeSet<(NodeName, NodeName)>,
    submaps: BTreeSet<u32>,
    /// Cells of submaps that are stale.
    cleared: BTreeMap<(u32, TileKey), Box<[u64; TILE_SIDE]>>,
}

impl RecordPublisher {
    /// The record publisher of the robot that settings name, which goes on with the log in `directory`, when there is one; `None` when they name
    /// none. A robot whose log is lost begins a new epoch.
    ///
    /// # Errors
    /// When the name is not one of a robot, the key cannot be had, or the disk refuses.
    pub fn open(settings: &FlockSettings, directory: &Path) -> Result<Option<Self>, StageError> {
        let flock = settings;
        if flock.name.is_empty() {
            return Ok(None);
        }
        let wrong = |error: RecordError| StageError::Source(format!("sync_manager.flock.name: {error}"));
        let (log, kept) = RecordLog::open(directory)?;
        let (key, epoch) = if flock.enabled {
            let mut identity = Identity::open(flock, directory)?;
            let key = identity.key(&flock.name).map_err(wrong)?;
            let has_published = kept.iter().any(|bytes| is_of(bytes, &key, identity.epoch()));
            let epoch = if has_published { identity.epoch() } else { identity.begin_epoch()? };
            (key, epoch)
        } else {
            (RobotKey::of_replay(&flock.name).map_err(wrong)?, FIRST_EPOCH)
        };
        let mut flock = Flock::new(key, epoch, Limits::default());
        restrict(&mut flock, settings);
        for bytes in &kept {
            // What cannot be read was refused when it came, or is of a robot that is banned by now.
            let _ = flock.collection_mut().take(bytes);
        }
        let published = Published::of(&flock, epoch);
        Ok(Some(Self { flock, epoch, log, published }))
    }

    /// What it knows.
    pub fn flock(&self) -> &Flock {
        &self.flock
    }

    /// The log that its records go to.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Numbers of the submaps that the flock knows.
    pub fn published_submaps(&self) -> &BTreeSet<u32> {
        &self.published.submaps
    }

    /// Says what is new of it.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn publish(&mut self, findings: Findings) -> Result<(), StageError> {
        let findings = self.published.new_of(findings);
        let records = self.flock.publish(&findings).map_err(record_failed)?;
        self.keep(&records)
    }

    /// Says what the evidence of a closed submap is, unless that is known.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn publish_submap(&mut self, submap: &Submap) -> Result<(), StageError> {
        if !self.published.submaps.insert(submap.number) {
            return Ok(());
        }
        let record = self.flock.record_submap(submap).map_err(record_failed)?;
        self.keep(&[record])
    }

    /// Says which cells of a submap are stale, as far as that is not known.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn publish_clearances(&mut self, submap: &Submap) -> Result<(), StageError> {
        for tile in submap.tiles.iter().filter(|tile| tile.has_cleared()) {
            let (key, rows) = ((submap.number, tile.key), Box::new(tile.cleared));
            if self.published.cleared.get(&key) == Some(&rows) {
                continue;
            }
            let clearance = Clearance {
                robot: self.flock.robot().clone(),
                epoch: self.epoch,
                submap: submap.number,
                tile: tile.key,
                rows: rows.clone(),
            };
            let record = self.flock.record(&Content::Clearance(clearance)).map_err(record_failed)?;
            self.keep(&[record])?;
            self.published.cleared.insert(key, rows);
        }
        Ok(())
    }

    /// Takes in a message of another robot and gives what to answer, with records for at most so many bytes.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn answer(
        &mut self,
        message: &Message,
        budget_bytes: usize,
        drops: &Drops,
    ) -> Result<Vec<Message>, StageError> {
        let Message::Records(records) = message else {
            return Ok(self.flock.answer(message, budget_bytes));
        };
        for bytes in records {
            match self.flock.collection_mut().take(bytes) {
                Ok(Outcome::New) => self.log.append(bytes)?,
                Ok(Outcome::Quarantined) => {
                    drops.count(Dropped::Quarantined, 1);
                    self.log.append(bytes)?;
                }
                Ok(Outcome::Known) => {}
                Ok(Outcome::Refused(refusal)) => drops.count(Dropped::Refused(refusal), 1),
                Err(RecordError::Version(_)) => drops.count(Dropped::Version, 1),
                Err(_) => drops.count(Dropped::BadRecord, 1),
            }
        }
        Ok(Vec::new())
    }

    /// Looks for places that it shares with others, with at most about so many searches; true when no candidate is left
    /// and nothing was found.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn search(&mut self, searches_max: u64) -> Result<bool, StageError> {
        let before = self.flock.searches();
        let mut found = self.flock.find(searches_max);
        let exhausted = self.flock.searches() - before >= searches_max;
        found.retain(|constraint| {
            !self.published.across.contains(&(constraint.from.clone(), constraint.to.clone()))
        });
        let records = self.flock.record_constraints(&found).map_err(record_failed)?;
        self.keep(&records)?;
        Ok(found.is_empty() && !exhausted)
    }

    fn keep(&mut self, records: &[Arc<[u8]>]) -> Result<(), StageError> {
        Ok(records.iter().try_for_each(|record| self.log.append(record))?)
    }
}

impl Published {
    fn of(flock: &Flock, epoch: u64) -> Self {
        let mut published = Self::default();
        let own = flock.robot();
        let records = flock.collection().records();
        for record in records.filter(|record| record.name.robot == *own && record.name.epoch == epoch) {
            match &record.content {
                Content::Stretch(stretch) => {
                    published.last = published.last.max(stretch.nodes.last().map(|node| node.sequence));
                }
                Content::Constraints(constraints) => published.note(constraints, own),
                Content::Submap(submap) => drop(published.submaps.insert(submap.number)),
                Content::Clearance(c) => {
                    published.cleared.insert((c.submap, c.tile), c.rows.clone());
                }
                Content::Withdrawal(_) => {}
            }
        }
        published
    }

    fn note(&mut self, constraints: &[Constraint], own: &RobotId) {
        for Constraint { from, to, .. } in constraints {
            if from.robot == *own {
                self.loops.insert((from.sequence, to.sequence));
            } else {
                self.across.insert((from.clone(), to.clone()));
            }
        }
    }

    /// Which findings have not been published; they count as published from now on.
    fn new_of(&mut self, findings: Findings) -> Findings {
        let mut new = Findings::default();
        for mut stretch in findings.stretches {
            let known = stretch.nodes.partition_point(|node| Some(node.sequence) <= self.last);
            if let Some(last) = stretch.nodes.drain(..known).next_back() {
                stretch.previous = Some(last.sequence);
            }
            if let Some(last) = stretch.nodes.last() {
                self.last = Some(last.sequence);
                new.stretches.push(stretch);
            }
        }
        let is_new = |found: &OwnLoop| self.loops.insert((found.from, found.to));
        new.loops = findings.loops.into_iter().filter(is_new).collect();
        new
    }
}

/// Robots whose records are used.
fn restrict(flock: &mut Flock, settings: &FlockSettings) {
    let own = flock.robot().clone();
    let keys = |listed: &[String]| crate::FlockSettings::keys(listed).unwrap_or_default();
    let collection = flock.collection_mut();
    collection.never_refuse(own);
    if !settings.trusted.is_empty() {
        collection.allow_only(keys(&settings.trusted));
    }
    keys(&settings.banned).into_iter().for_each(|key| collection.ban(key));
}

fn is_of(bytes: &[u8], key: &RobotKey, epoch: u64) -> bool {
    Record::read(bytes).is_ok_and(|record| record.name.robot == *key.id() && record.name.epoch == epoch)
}

fn record_failed(error: RecordError) -> StageError {
    StageError::file("a record for the flock", error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Pose;
    use flockslam_loop_closure::closure::Closure;
    use flockslam_pose_graph::Edge;
    use flockslam_records::{Descriptor, RecordedNode, Stretch};
    use flockslam_registration::cloud::Placement;

    fn findings(sequences: std::ops::Range<u64>) -> Findings {
        let node = |sequence: u64| RecordedNode {
            sequence,
            submap: 0,
            odom_from_base: Pose::new(sequence as f64, 0.0, 0.0),
            motion: Pose::new(1.0, 0.0, 0.0),
            information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
            drift_bound_m: 0.0,
            points: vec![[1, 2]],
        };
        let previous = sequences.start.checked_sub(1);
        let nodes = sequences.map(node).collect();
        Findings {
            stretches: vec![Stretch { trajectory: 0, previous, descriptor: Descriptor::default(), nodes }],
            loops: Vec::new(),
        }
    }

    fn with_loop(mut findings: Findings, from: u64, to: u64) -> Findings {
        let information = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0];
        let edge = Edge { from: 0, to: 1, motion: Placement::IDENTITY, information };
        findings.loops.push(OwnLoop { from, to, closure: Closure { edge, reach_m: 1.0, shift_m: 0.0 } });
        findings
    }

    fn settings(enabled: bool) -> FlockSettings {
        let mut settings = FlockSettings::default();
        (settings.name, settings.enabled) = ("a".to_owned(), enabled);
        settings
    }

    fn nodes(publisher: &RecordPublisher) -> Vec<(Option<u64>, u64)> {
        let published = |record: &Arc<Record>| match &record.content {
            Content::Stretch(stretch) => Some((stretch.previous, stretch.nodes.last()?.sequence)),
            _ => None,
        };
        publisher.flock().collection().records().filter_map(published).collect()
    }

    fn loops(publisher: &RecordPublisher) -> Vec<(u64, u64)> {
        let published = |record: &Arc<Record>| -> Vec<(u64, u64)> {
            match &record.content {
                Content::Constraints(some) => some.iter().map(|c| (c.from.sequence, c.to.sequence)).collect(),
                _ => Vec::new(),
            }
        };
        publisher.flock().collection().records().flat_map(published).collect()
    }

    #[test]
    fn a_restarted_process_publishes_no_node_and_no_loop_twice() {
        for enabled in [false, true] {
            let directory = tempfile::tempdir().unwrap();
            let open = || RecordPublisher::open(&settings(enabled), directory.path()).unwrap().unwrap();
            let mut first = open();
            first.publish(findings(0..5)).unwrap();
            first.publish(with_loop(findings(5..8), 1, 6)).unwrap();
            let published = first.flock().collection().hash();
            drop(first);
            let mut second = open();
            assert_eq!(second.flock().collection().hash(), published);
            // It takes in all of the journal again.
            second.publish(findings(0..6)).unwrap();
            second.publish(with_loop(with_loop(findings(6..10), 1, 6), 2, 7)).unwrap();
            assert_eq!(nodes(&second), [(None, 4), (Some(4), 7), (Some(7), 9)]);
            assert_eq!(loops(&second), [(1, 6), (2, 7)]);
            assert_eq!(second.epoch(), 1);
        }
    }

    #[test]
    fn a_robot_without_its_log_begins_a_new_epoch() {
        let (keys, first, second) =
            (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut settings = settings(true);
        settings.key_file = keys.path().join("a.key");
        let open = |directory: &tempfile::TempDir| {
            RecordPublisher::open(&settings, directory.path()).unwrap().unwrap()
        };
        let mut before = open(&first);
        before.publish(findings(0..5)).unwrap();
        drop(before);
        let mut restarted = open(&second);
        assert_eq!(restarted.epoch(), 2);
        // What others have of its first epoch is not what it publishes now.
        let records =
            Message::Records(RecordLog::read(first.path()).unwrap().into_iter().map(Arc::from).collect());
        restarted.answer(&records, 0, &Drops::default()).unwrap();
        restarted.publish(findings(0..3)).unwrap();
        assert_eq!(nodes(&restarted), [(None, 4), (None, 2)]);
        drop(restarted);
        assert_eq!(open(&second).epoch(), 2);
    }

    #[test]
    fn what_others_send_is_kept_or_counted() {
        let directory = tempfile::tempdir().unwrap();
        let mut publisher = RecordPublisher::open(&settings(true), directory.path()).unwrap().unwrap();
        let other = RobotKey::of_replay("b").unwrap();
        let record = |number: u64, trajectory: u32| {
            let mut findings = findings(0..2);
            findings.stretches[0].trajectory = trajectory;
            let content = Content::Stretch(findings.stretches.remove(0));
            Record::new(&other, 1, number, &content).unwrap().bytes().clone()
        };
        let drops = Drops::default();
        let mut bent = record(1, 0).to_vec();
        bent[80] ^= 1;
        let mut later = record(1, 0).to_vec();
        later[4] = 99;
        let message =
            Message::Records(vec![record(0, 0), record(0, 1), bent.into(), later.into(), record(2, 0)]);
        publisher.answer(&message, 0, &drops).unwrap();
        let counted = drops.by_name();
        let expected = [("bad-record", 1), ("quarantined", 1), ("unknown-version", 1)];
        assert!(counted.iter().map(|(name, n)| (name.as_str(), *n)).eq(expected), "{counted:?}");
        let known = publisher.flock().collection().hash();
        drop(publisher);
        let again = RecordPublisher::open(&settings(true), directory.path()).unwrap().unwrap();
        assert_eq!(again.flock().collection().hash(), known);
        let mut strict = settings(true);
        strict.banned = vec![crate::link::hexadecimal(other.id().public_key())];
        drop(again);
        let strict = RecordPublisher::open(&strict, directory.path()).unwrap().unwrap();
        assert_eq!(strict.flock().collection().robots().count(), 0);
    }
}
