//! What a robot knows of all logs: records go in from anybody, in any order; the records that hold, a version vector and
//! answers to other robots come out.

use crate::content::Content;
use crate::flock_message::{MESSAGE_BYTES_MAX, Message};
use crate::kind::Kind;
use crate::{LogState, Numbers, Record, RecordError, RecordName, RobotId, Vector};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

mod robot_log;
#[cfg(test)]
mod tests;

use robot_log::Log;

/// Limits of a collection: records beyond are refused and counted, so that no robot can fill another's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Greatest number of robots.
    pub robots_max: usize,
    /// Logs of one robot.
    pub epochs_max: usize,
    /// Records of one log.
    pub records_max: u64,
    /// Bytes of all records of one robot.
    pub robot_bytes_max: u64,
    /// Bytes of all records of all robots but those of [`Collection::never_refuse`].
    pub bytes_max: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            robots_max: 256,
            epochs_max: 64,
            records_max: 200_000,
            robot_bytes_max: 256 << 20,
            bytes_max: 1 << 30,
        }
    }
}

/// The fate of a record that was handed in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It was not known before.
    New,
    /// It was known: nothing has changed.
    Known,
    /// Another record has the same name: neither counts any more.
    Quarantined,
    /// It is not taken in.
    Refused(Refusal),
}

/// Why a record that is whole is not taken in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Refusal {
    /// Its robot has been banned, or is not among those that are trusted.
    NotTrusted,
    /// There are more robots than may be known.
    Robots,
    /// Its robot has begun more logs than it may.
    Epochs,
    /// Its number is beyond the limit of a log.
    Records,
    /// Its robot has exceeded its limit.
    Bytes,
    /// All robots together have exceeded the limit.
    AllBytes,
}

impl Refusal {
    /// All of them.
    pub const ALL: [Refusal; 6] =
        [Self::NotTrusted, Self::Robots, Self::Epochs, Self::Records, Self::Bytes, Self::AllBytes];

    /// Its name in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotTrusted => "not-trusted",
            Self::Robots => "too-many-robots",
            Self::Epochs => "too-many-epochs",
            Self::Records => "too-many-records",
            Self::Bytes => "too-many-bytes",
            Self::AllBytes => "too-many-bytes-in-all",
        }
    }
}

/// Counts of records handed in so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Records that were new.
    pub taken: u64,
    /// Records that were known.
    pub known: u64,
    /// Names with two records.
    pub quarantined: u64,
    /// Bytes that were no record.
    pub malformed: u64,
    /// Records refused, by reason.
    pub refused: BTreeMap<Refusal, u64>,
}

/// All records that a robot has, its own among them.
///
/// It only grows, and what it holds depends on the set of records alone, not on the order in which they came (as long as no limit is
/// met): a state-based replicated set (Shapiro et al. 2011).
///
/// ```
/// use flockslam_records::{Collection, Content, Message, Record, RobotKey, Withdrawal};
///
/// let key = RobotKey::of_replay("robot-1")?;
/// let (mut ours, mut theirs) = (Collection::default(), Collection::default());
/// for number in 0..3 {
///     let content = Content::Withdrawal(Withdrawal { epoch: 0, number });
///     ours.insert(Record::new(&key, 1, number, &content)?);
/// }
/// // They say what they have, and take in what we answer.
/// for answer in ours.answer(&Message::Have(theirs.vector()), 1 << 20) {
///     theirs.answer(&answer, 1 << 20);
/// }
/// assert_eq!(theirs.records().count(), 3);
/// assert_eq!(theirs.hash(), ours.hash());
/// # Ok::<(), flockslam_records::RecordError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Collection {
    limits: Limits,
    /// Accepted robots; `None` = all that are not banned.
    trusted: Option<BTreeSet<[u8; 32]>>,
    banned: BTreeSet<[u8; 32]>,
    /// Whose records are never too many.
    own: Option<RobotId>,
    logs: BTreeMap<(RobotId, u64), Log>,
    /// Records that their authors have withdrawn.
    withdrawn: BTreeSet<RecordName>,
    tally: Tally,
}

impl Collection {
    /// An empty collection that takes records of every robot.
    pub fn new(limits: Limits) -> Self {
        Self { limits, ..Self::default() }
    }

    /// Takes only records of robots with these public keys from now on.
    pub fn allow_only(&mut self, keys: impl IntoIterator<Item = [u8; 32]>) {
        self.trusted = Some(keys.into_iter().collect());
        self.drop_untrusted();
    }

    /// Bans a key: refuses its records, and removes those that are there.
    pub fn ban(&mut self, public_key: [u8; 32]) {
        self.banned.insert(public_key);
        self.drop_untrusted();
    }

    /// Inserts a record of this robot without a limit: records of others must not displace its own.
    pub fn never_refuse(&mut self, robot: RobotId) {
        self.own = Some(robot);
    }

    fn allows(&self, robot: &RobotId) -> bool {
        if self.own.as_ref() == Some(robot) {
            return true;
        }
        let listed = self.trusted.as_ref().is_none_or(|keys| keys.contains(robot.public_key()));
        listed && !self.banned.contains(robot.public_key())
    }

    fn drop_untrusted(&mut self) {
        let logs = std::mem::take(&mut self.logs);
        self.logs = logs.into_iter().filter(|((robot, _), _)| self.allows(robot)).collect();
        let withdrawn = std::mem::take(&mut self.withdrawn);
        self.withdrawn = withdrawn.into_iter().filter(|name| self.allows(&name.robot)).collect();
    }

    /// Takes in bytes from anybody.
    ///
    /// # Errors
    /// When they are not one well-formed record, signed by the robot that it names.
    pub fn take(&mut self, bytes: &[u8]) -> Result<Outcome, RecordError> {
        // What is known need not be checked again: a flood of it costs a hash each.
        match Record::peek(bytes) {
            Ok((name, hash)) if self.holds(&name, &hash) => {
                self.tally.known += 1;
                return Ok(Outcome::Known);
            }
            Ok((name, _)) => {
                if let Some(refusal) = self.refusal(&name, bytes.len()) {
                    return Ok(self.refuse(refusal));
                }
            }
            Err(error) => {
                self.tally.malformed += 1;
                return Err(error);
            }
        }
        match Record::read(bytes) {
            Ok(record) => Ok(self.insert(record)),
            Err(error) => {
                self.tally.malformed += 1;
                Err(error)
            }
        }
    }

    /// Takes in a record.
    pub fn insert(&mut self, record: Record) -> Outcome {
        if self.holds(&record.name, &record.hash) {
            self.tally.known += 1;
            return Outcome::Known;
        }
        if let Some(refusal) = self.refusal(&record.name, record.bytes().len()) {
            return self.refuse(refusal);
        }
        let name = record.name.clone();
        let withdrawal = match &record.content {
            Content::Withdrawal(withdrawal) => Some(*withdrawal),
            _ => None,
        };
        let log = self.logs.entry((name.robot.clone(), name.epoch)).or_default();
        if !log.insert(record) {
            self.tally.quarantined += 1;
            self.withdrawn = self.withdrawals();
            return Outcome::Quarantined;
        }
        if let Some(withdrawal) = withdrawal {
            let (epoch, number) = (withdrawal.epoch, withdrawal.number);
            self.withdrawn.insert(RecordName { robot: name.robot, epoch, number });
        }
        self.tally.taken += 1;
        Outcome::New
    }

    fn refuse(&mut self, refusal: Refusal) -> Outcome {
        *self.tally.refused.entry(refusal).or_default() += 1;
        Outcome::Refused(refusal)
    }

    fn holds(&self, name: &RecordName, hash: &[u8; 32]) -> bool {
        let log = self.logs.get(&(name.robot.clone(), name.epoch));
        log.is_some_and(|log| log.holds(name.number, hash))
    }

    /// Why a record of this name and size is not taken in, if so.
    fn refusal(&self, name: &RecordName, bytes: usize) -> Option<Refusal> {
        if !self.allows(&name.robot) {
            return Some(Refusal::NotTrusted);
        }
        if self.own.as_ref() == Some(&name.robot) {
            return None;
        }
        if name.number >= self.limits.records_max {
            return Some(Refusal::Records);
        }
        let of_robot = || self.logs.range((name.robot.clone(), 0)..=(name.robot.clone(), u64::MAX));
        if of_robot().next().is_none() && self.robots().count() >= self.limits.robots_max {
            return Some(Refusal::Robots);
        }
        let begun = self.logs.contains_key(&(name.robot.clone(), name.epoch));
        if !begun && of_robot().count() >= self.limits.epochs_max {
            return Some(Refusal::Epochs);
        }
        let robot_bytes: u64 = of_robot().map(|(_, log)| log.bytes()).sum();
        let bytes = bytes as u64;
        if robot_bytes + bytes > self.limits.robot_bytes_max {
            return Some(Refusal::Bytes);
        }
        let of_others = self.logs.iter().filter(|((robot, _), _)| self.own.as_ref() != Some(robot));
        let all: u64 = of_others.map(|(_, log)| log.bytes()).sum();
        (all + bytes > self.limits.bytes_max).then_some(Refusal::AllBytes)
    }

    /// Withdrawn records.
    fn withdrawals(&self) -> BTreeSet<RecordName> {
        let withdrawn = |record: &Arc<Record>| match &record.content {
            Content::Withdrawal(w) => Some((record.name.robot.clone(), w.epoch, w.number)),
            _ => None,
        };
        let all = self.logs.values().flat_map(Log::records).filter_map(withdrawn);
        all.map(|(robot, epoch, number)| RecordName { robot, epoch, number }).collect()
    }

    /// All records that hold – neither withdrawn nor in doubt – in the order of their names.
    pub fn records(&self) -> impl Iterator<Item = &Arc<Record>> {
        let all = self.logs.values().flat_map(Log::records);
        all.filter(|record| self.withdrawn.is_empty() || !self.withdrawn.contains(&record.name))
    }

    /// All robots with records here, in order.
    pub fn robots(&self) -> impl Iterator<Item = &RobotId> {
        let mut last = None;
        self.logs.keys().map(|(robot, _)| robot).filter(move |robot| last.replace(*robot) != Some(*robot))
    }

    /// The number that a robot's next record in this epoch has.
    pub fn next_number(&self, robot: &RobotId, epoch: u64) -> u64 {
        self.logs.get(&(robot.clone(), epoch)).map_or(0, |log| log.numbers().end())
    }

    /// Counts of records handed in so far.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Bytes of all records.
    pub fn bytes(&self) -> u64 {
        self.logs.values().map(Log::bytes).sum()
    }

    /// The version vector of this collection.
    pub fn vector(&self) -> Vector {
        let state = |((robot, epoch), log): (&(RobotId, u64), &Log)| LogState {
            robot: robot.clone(),
            epoch: *epoch,
            numbers: log.numbers().clone(),
            digest: log.digest(),
        };
        Vector { logs: self.logs.iter().map(state).collect() }
    }

    /// A hash over all that is held: equal for collections that hold the same.
    pub fn hash(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for log in self.vector().logs {
            hasher.update(log.robot.to_string().as_bytes()).update(log.robot.public_key());
            hasher.update(&log.epoch.to_le_bytes()).update(&log.numbers.count().to_le_bytes());
            hasher.update(&log.digest);
        }
        *hasher.finalize().as_bytes()
    }

    /// Records that somebody with this vector has not, the most urgent first and older before newer, up to so many bytes (and at
    /// least one, if there is any).
    pub fn missing(&self, theirs: &Vector, budget_bytes: usize) -> Vec<Arc<[u8]>> {
        let none = Numbers::default();
        let mut wanted: Vec<(Kind, u64, &Arc<[u8]>)> = Vec::new();
        for ((robot, epoch), log) in &self.logs {
            let theirs = theirs.log(robot, *epoch).map_or(&none, |log| &log.numbers);
            for (number, slot) in log.slots().filter(|(number, _)| !theirs.contains(*number)) {
                slot.each(|kind, bytes| wanted.push((kind, number, bytes)));
            }
        }
        wanted.sort_by_key(|(kind, number, _)| (*kind, *number));
        let mut left = budget_bytes;
        let mut out = Vec::new();
        for (_, _, bytes) in wanted {
            if bytes.len() > left && !out.is_empty() {
                break;
            }
            left = left.saturating_sub(bytes.len());
            out.push(Arc::clone(bytes));
        }
        out
    }

    /// What to answer to a message, with records for at most so many bytes. Records in it are taken in: bytes that are none are
    /// counted.
    pub fn answer(&mut self, message: &Message, budget_bytes: usize) -> Vec<Message> {
        match message {
            Message::Have(theirs) => {
                let mut answers = Vec::new();
                let missing = self.missing(theirs, budget_bytes);
                pack(missing, &mut answers);
                answers.extend(self.disputes(theirs));
                answers
            }
            Message::Records(records) => {
                for bytes in records {
                    // Counted inside.
                    let _ = self.take(bytes);
                }
                Vec::new()
            }
            Message::Hashes { robot, epoch, hashes } => {
                let mut answers = Vec::new();
                pack(self.disputed(robot, *epoch, hashes, budget_bytes), &mut answers);
                answers
            }
            Message::Here(_) => Vec::new(),
        }
    }

    /// The hashes of logs of which they have the same numbers, but other records.
    fn disputes(&self, theirs: &Vector) -> Vec<Message> {
        let disputed = |((robot, epoch), log): (&(RobotId, u64), &Log)| {
            let other = theirs.log(robot, *epoch)?;
            let differs = other.numbers == *log.numbers() && other.digest != log.digest();
            differs.then(|| Message::Hashes { robot: robot.clone(), epoch: *epoch, hashes: log.hashes() })
        };
        self.logs.iter().filter_map(disputed).collect()
    }

    /// What others need to see that two records have one name.
    fn disputed(
        &self,
        robot: &RobotId,
        epoch: u64,
        hashes: &[(u64, [u8; 32])],
        budget_bytes: usize,
    ) -> Vec<Arc<[u8]>> {
        let Some(log) = self.logs.get(&(robot.clone(), epoch)) else { return Vec::new() };
        let mut out: Vec<Arc<[u8]>> = Vec::new();
        let mut left = budget_bytes;
        for (number, hash) in hashes {
            let Some(slot) = log.slot(*number).filter(|slot| !slot.is_just(hash)) else { continue };
            slot.each(|_, bytes| {
                if left >= bytes.len() {
                    left -= bytes.len();
                    out.push(Arc::clone(bytes));
                }
            });
        }
        out
    }
}

/// Puts records into messages of bounded size.
fn pack(records: Vec<Arc<[u8]>>, messages: &mut Vec<Message>) {
    let mut group: Vec<Arc<[u8]>> = Vec::new();
    let mut size = 0;
    for record in records {
        if size + record.len() + 16 > MESSAGE_BYTES_MAX / 4 && !group.is_empty() {
            messages.push(Message::Records(std::mem::take(&mut group)));
            size = 0;
        }
        size += record.len() + 4;
        group.push(record);
    }
    if !group.is_empty() {
        messages.push(Message::Records(group));
    }
}
