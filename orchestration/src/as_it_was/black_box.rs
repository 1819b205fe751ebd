//! What a recording of a set holds: scans, published poses, and what each stage has used and said.

use crate::supervisor::SetFile;
use flockslam_messages::{
    ClearedCell, Commit, CommitName, PoseEstimate, ScanBuffer, Stage, StageInputs, StageStart,
};
use flockslam_recordings::{
    Reading, ReadingKind, Recording, RecordingError, SET_RECORD_TYPE, SetRecord, is_recording,
};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Why a recording cannot be run again.
#[derive(Debug, thiserror::Error)]
pub enum BlackBoxError {
    /// It cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// It is none of a set.
    #[error("{0}: --as-it-was runs recordings by flockslam record again; without it any recording is mapped")]
    NotOfASet(String),
    /// Another build has recorded it.
    #[error(
        "{0}: recorded by another build of flockslam, whose stages cannot be run again here; map it without --as-it-was"
    )]
    AnotherBuild(String),
    /// The configuration of the set is not in it, or not understood.
    #[error("{name}: the configuration of the set: {problem}")]
    Configuration {
        /// The recording.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The numbers of the scans begin again in it.
    #[error("{0}: the set began another map while it was recorded; record each map on its own")]
    SeveralMaps(String),
}

/// A recording of a set in memory.
pub struct BlackBox {
    /// Options and configuration of the set.
    pub set: SetFile,
    /// By their sequence.
    pub scans: BTreeMap<u64, ScanBuffer>,
    /// As they were published, by the sequence of the scan.
    pub poses: BTreeMap<u64, PoseEstimate>,
    /// Of scan-matcher, in their order.
    pub matcher: Vec<StageInputs>,
    /// Of dynamic-cleaner, in their order.
    pub cleaner: Vec<StageInputs>,
    /// In their order.
    pub commits: Vec<Commit>,
    /// Cleared cells by the sequence of the scan.
    pub marks: BTreeMap<u64, Vec<ClearedCell>>,
    /// Why it ends before its end.
    pub cut_short: Option<String>,
    pub(super) places: HashMap<CommitName, usize>,
}

impl BlackBox {
    /// Reads a recording.
    ///
    /// # Errors
    /// When it is none of a set by this build, or cannot be read.
    pub fn read(path: &Path) -> Result<Self, BlackBoxError> {
        if path.is_file() && !is_recording(path) {
            return Err(BlackBoxError::NotOfASet(path.display().to_string()));
        }
        let mut recording = Recording::open(path)?;
        let name = recording.name().to_owned();
        let of_kind = |kind| {
            let topics = recording.topics().iter().enumerate();
            topics.filter(move |(_, topic)| topic.kind() == Some(kind)).map(|(at, _)| at)
        };
        let records: Vec<usize> = of_kind(ReadingKind::SetRecord).collect();
        let wanted: Vec<usize> = of_kind(ReadingKind::BusScan).chain(records.iter().copied()).collect();
        if records.is_empty() {
            let is_of_a_set = recording.topics().iter().any(|topic| topic.type_name == SET_RECORD_TYPE);
            return Err(if is_of_a_set {
                BlackBoxError::AnotherBuild(name)
            } else {
                BlackBoxError::NotOfASet(name)
            });
        }
        recording.want(&wanted);
        let (mut set, mut found) = (None, Contents::default());
        while let Some(message) = recording.next_reading()? {
            match message.reading {
                Ok(Reading::BusScan(scan)) => {
                    found.scans.insert(scan.header.id.sequence, scan);
                }
                Ok(Reading::SetRecord(SetRecord::Set(json))) => set = Some(json),
                Ok(Reading::SetRecord(record)) => found.take(record),
                // A damaged one is missed where it is needed.
                _ => {}
            }
        }
        if found.begins_again {
            return Err(BlackBoxError::SeveralMaps(name));
        }
        let wrong = |problem: String| BlackBoxError::Configuration { name: name.clone(), problem };
        let set = set.ok_or_else(|| wrong("it is not in the recording".to_owned()))?;
        let set: SetFile = serde_json::from_slice(&set).map_err(|error| wrong(error.to_string()))?;
        let Contents { scans, poses, matcher, cleaner, commits, marks, .. } = found;
        let places = commits.iter().enumerate().map(|(at, commit)| (commit.name, at)).collect();
        let cut_short = recording.cut_short().map(str::to_owned);
        Ok(Self { set, scans, poses, matcher, cleaner, commits, marks, cut_short, places })
    }

    /// The place of a commit among all of them.
    pub fn place_of(&self, name: CommitName) -> Option<usize> {
        self.places.get(&name).copied()
    }
}

#[derive(Default)]
struct Contents {
    scans: BTreeMap<u64, ScanBuffer>,
    poses: BTreeMap<u64, PoseEstimate>,
    matcher: Vec<StageInputs>,
    cleaner: Vec<StageInputs>,
    commits: Vec<Commit>,
    marks: BTreeMap<u64, Vec<ClearedCell>>,
    begins_again: bool,
}

impl Contents {
    fn take(&mut self, record: SetRecord) {
        match record {
            SetRecord::Pose(pose) => drop(self.poses.insert(pose.id.sequence, pose)),
            SetRecord::Inputs(inputs) if inputs.stage == Stage::ScanMatcher as u32 => {
                let is_new = inputs.start == StageStart::Anew as u32 && inputs.handled == 1;
                let last = self.matcher.last().map(|last| last.id.sequence);
                self.begins_again |= is_new && last >= Some(inputs.id.sequence);
                self.matcher.push(inputs);
            }
            SetRecord::Inputs(inputs) => self.cleaner.push(inputs),
            SetRecord::Commit(commit) => self.commits.push(commit),
            SetRecord::Marks(header, cells) => drop(self.marks.insert(header.id.sequence, cells)),
            // The matcher says which verdict it has used: the recorded one may have come too late.
            SetRecord::Verdict(_) | SetRecord::Set(_) => {}
        }
    }
}
