//! Reads the scans of a recording, each with the lidar's place on the robot and with its odometry.

use crate::carmen::Tally;
use crate::scan_locator::{LocateError, ScanLocator};
use crate::settings::Settings;
use flockslam_messages::ScanBuffer;
use flockslam_recordings::{Reading, ReadingKind, Recording, RecordingError, Topic};
use std::path::Path;

/// Why a recording is not read to its end: one line with place, reason and cure.
#[derive(Debug, thiserror::Error)]
pub enum ReadRecordingError {
    /// It cannot be read, or is damaged.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// No scan in it.
    #[error("{name}: no sensor_msgs/LaserScan among its topics: {topics}")]
    NoScan {
        /// The recording.
        name: String,
        /// What there is.
        topics: String,
    },
    /// More than one lidar.
    #[error("{name}: scans on {topics}: choose one with --scan TOPIC")]
    SeveralScans {
        /// The recording.
        name: String,
        /// Those with scans.
        topics: String,
    },
    /// More than one odometry.
    #[error("{name}: odometry on {topics}: choose one with --odom TOPIC")]
    SeveralOdometries {
        /// The recording.
        name: String,
        /// Those with odometry.
        topics: String,
    },
    /// A topic that was named is not there, or says something else.
    #[error("{name}: no {kind} on {topic}; there are: {topics}")]
    NoTopic {
        /// The recording.
        name: String,
        /// What was looked for.
        kind: &'static str,
        /// The topic that was named.
        topic: String,
        /// What there is.
        topics: String,
    },
    /// A scan cannot be placed on the robot.
    #[error("{name}: {problem}")]
    NotLocated {
        /// The recording.
        name: String,
        /// The reason.
        problem: LocateError,
    },
}

/// Scans of a recording in its order, those of one topic.
pub struct RecordingReader {
    recording: Recording,
    locator: ScanLocator,
    expected: u64,
    at_end: bool,
    last_stamp_ns: Option<i64>,
    tally: Tally,
}

impl RecordingReader {
    /// Opens a recording and chooses what is read of it.
    ///
    /// # Errors
    /// When it cannot be read, or it is not clear which scans or which odometry are meant.
    pub fn open(path: &Path, settings: &Settings) -> Result<Self, ReadRecordingError> {
        let mut recording = Recording::open(path)?;
        let scans = chosen_scans(&recording, settings.scan_topic.as_deref())?;
        let mut wanted = vec![scans];
        wanted.extend(chosen_odometry(&recording, settings.odometry_topic.as_deref())?);
        let topics = recording.topics().iter().enumerate();
        let transforms = topics.filter(|(_, topic)| topic.kind() == Some(ReadingKind::Transforms));
        wanted.extend(transforms.map(|(at, _)| at));
        let expected = recording.topics()[scans].messages;
        recording.want(&wanted);
        Ok(Self {
            recording,
            locator: ScanLocator::new(settings.lidars.first()),
            expected,
            at_end: false,
            last_stamp_ns: None,
            tally: Tally::default(),
        })
    }

    /// Number of scans that the recording says it has.
    pub fn expected_scans(&self) -> u64 {
        self.expected
    }

    /// What was met so far; a message is a line.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Why the recording ended before its end, once that was met.
    pub fn cut_short(&self) -> Option<&str> {
        self.recording.cut_short()
    }

    /// Reads the next scan into `scan`; `false` at the end.
    ///
    /// # Errors
    /// When the recording or a message is damaged, or the lidar's place on the robot is not known.
    pub fn next_scan(&mut self, scan: &mut ScanBuffer) -> Result<bool, ReadRecordingError> {
        loop {
            let located = self.locator.take(self.at_end).map_err(|problem| {
                ReadRecordingError::NotLocated { name: self.recording.name().to_owned(), problem }
            })?;
            if let Some(located) = located {
                *scan = located;
                self.count(scan);
                return Ok(true);
            }
            if self.at_end {
                return Ok(false);
            }
            let Some((topic, recorded_ns, reading)) = self.recording.next_reading()? else {
                self.at_end = true;
                continue;
            };
            self.tally.lines += 1;
            match reading {
                Reading::Scan(framed) => self.locator.push_scan(recorded_ns, framed),
                Reading::Odometry(odometry) => self.locator.push_odometry(recorded_ns, &odometry),
                Reading::Transforms(transforms) => {
                    let is_static = self.recording.topics()[topic].name.ends_with("tf_static");
                    self.locator.push_transforms(recorded_ns, &transforms, is_static);
                }
            }
        }
    }

    fn count(&mut self, scan: &mut ScanBuffer) {
        scan.header.id.sequence = self.tally.scans;
        self.tally.scans += 1;
        let stamp_ns = scan.header.times.sensor_ns;
        self.tally.steps_backward += u64::from(self.last_stamp_ns.is_some_and(|last| stamp_ns <= last));
        self.last_stamp_ns = Some(stamp_ns);
    }
}

type Found<'a> = Vec<(usize, &'a Topic)>;

/// Topics of a kind that have messages.
fn topics_of(recording: &Recording, is_kind: impl Fn(ReadingKind) -> bool) -> Found<'_> {
    let has = |topic: &Topic| topic.messages > 0 && topic.kind().is_some_and(&is_kind);
    recording.topics().iter().enumerate().filter(|(_, topic)| has(topic)).collect()
}

fn names(topics: &Found<'_>) -> String {
    let names: Vec<String> =
        topics.iter().map(|(_, topic)| format!("{} ({})", topic.name, topic.messages)).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

fn named(topics: &Found<'_>, wanted: &str) -> Option<usize> {
    let is_same = |topic: &Topic| topic.name.trim_start_matches('/') == wanted.trim_start_matches('/');
    topics.iter().find(|(_, topic)| is_same(topic)).map(|(at, _)| *at)
}

fn chosen_scans(recording: &Recording, wanted: Option<&str>) -> Result<usize, ReadRecordingError> {
    let scans = topics_of(recording, ReadingKind::is_scan);
    let name = recording.name().to_owned();
    match (wanted, scans.as_slice()) {
        (Some(topic), _) => named(&scans, topic).ok_or_else(|| {
            let (topic, topics) = (topic.to_owned(), names(&scans));
            ReadRecordingError::NoTopic { name, kind: "scans", topic, topics }
        }),
        (None, [(only, _)]) => Ok(*only),
        (None, []) => {
            let all: Vec<String> = recording
                .topics()
                .iter()
                .map(|topic| format!("{} ({}, {})", topic.name, topic.type_name, topic.messages))
                .collect();
            let topics = if all.is_empty() { "there are none".to_owned() } else { all.join(", ") };
            Err(ReadRecordingError::NoScan { name, topics })
        }
        (None, _) => Err(ReadRecordingError::SeveralScans { name, topics: names(&scans) }),
    }
}

fn chosen_odometry(recording: &Recording, wanted: Option<&str>) -> Result<Option<usize>, ReadRecordingError> {
    let found = topics_of(recording, |kind| kind == ReadingKind::Odometry);
    let name = recording.name().to_owned();
    match (wanted, found.as_slice()) {
        (Some(topic), _) => named(&found, topic).map(Some).ok_or_else(|| {
            let (topic, topics) = (topic.to_owned(), names(&found));
            ReadRecordingError::NoTopic { name, kind: "odometry", topic, topics }
        }),
        (None, []) => Ok(None),
        (None, [(only, _)]) => Ok(Some(*only)),
        (None, _) => Err(ReadRecordingError::SeveralOdometries { name, topics: names(&found) }),
    }
}
