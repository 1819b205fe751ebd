//! Chooses what is read of a recording: by the types of its topics, and by the names that the settings give.

use crate::scan_locator::LocateError;
use crate::settings::Settings;
use flockslam_recordings::{ReadingKind, Recording, RecordingError, Topic};

/// Why a recording is not read to its end: one line with place, reason and cure.
#[derive(Debug, thiserror::Error)]
pub enum ReadRecordingError {
    /// It cannot be read, or is damaged.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// No scan in it.
    #[error(
        "{name}: no sensor_msgs/LaserScan or PointCloud2 among its topics: {topics}; record the topic of the lidar too"
    )]
    NoScan {
        /// The recording.
        name: String,
        /// What there is.
        topics: String,
    },
    /// More than one lidar.
    #[error(
        "{name}: scans on {topics}: choose one with --scan TOPIC, or name that of each lidar with a --scan of its own"
    )]
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
    /// A topic that was named does not exist, or has another type.
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

/// Topics of a recording that are read, by their numbers in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicChoice {
    /// Scans or clouds of points: one for each lidar.
    pub scans: Vec<usize>,
    /// Odometry; `None`: from transforms, if they have it.
    pub odometry: Option<usize>,
    /// An IMU.
    pub imu: Option<usize>,
}

impl TopicChoice {
    /// Chooses among the topics that have messages.
    ///
    /// # Errors
    /// When there are no scans, when several topics could be meant, or when a topic that is named is not there.
    pub fn of(recording: &Recording, settings: &Settings) -> Result<Self, ReadRecordingError> {
        if let Some((of_a_set, _)) = topics_of(recording, |kind| kind == ReadingKind::BusScan).first() {
            // Scans as a set had them want nothing.
            return Ok(Self { scans: vec![*of_a_set], odometry: None, imu: None });
        }
        let odometry = chosen_odometry(recording, settings.odometry_topic.as_deref())?;
        let imus = topics_of(recording, |kind| kind == ReadingKind::Imu);
        let imu = match &settings.imu_topic {
            Some(topic) => Some(named(recording, &imus, "IMU", topic)?),
            None if odometry.is_some() => None,
            None => imus.first().map(|(at, _)| *at),
        };
        Ok(Self { scans: chosen_scans(recording, &settings.scan_topics)?, odometry, imu })
    }

    /// What a topic is used for.
    pub fn use_of(&self, at: usize, topic: &Topic) -> Option<String> {
        if let Some(lidar) = self.scans.iter().position(|scans| *scans == at) {
            return Some(if self.scans.len() > 1 { format!("lidar {lidar}") } else { "lidar".to_owned() });
        }
        if self.odometry == Some(at) {
            return Some("odometry".to_owned());
        }
        if self.imu == Some(at) {
            return Some("turns".to_owned());
        }
        (topic.kind() == Some(ReadingKind::Transforms)).then(|| "transforms".to_owned())
    }

    /// With those that have transforms.
    pub fn all(&self, recording: &Recording) -> Vec<usize> {
        let transforms = topics_of(recording, |kind| kind == ReadingKind::Transforms);
        let transforms = transforms.iter().map(|(at, _)| *at);
        self.scans.iter().copied().chain(self.odometry).chain(self.imu).chain(transforms).collect()
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

fn named(
    recording: &Recording,
    topics: &Found<'_>,
    kind: &'static str,
    wanted: &str,
) -> Result<usize, ReadRecordingError> {
    let is_same = |topic: &Topic| topic.name.trim_start_matches('/') == wanted.trim_start_matches('/');
    topics.iter().find(|(_, topic)| is_same(topic)).map(|(at, _)| *at).ok_or_else(|| {
        let (name, topic, topics) = (recording.name().to_owned(), wanted.to_owned(), names(topics));
        ReadRecordingError::NoTopic { name, kind, topic, topics }
    })
}

fn chosen_scans(recording: &Recording, wanted: &[String]) -> Result<Vec<usize>, ReadRecordingError> {
    let mut scans = topics_of(recording, ReadingKind::is_scan);
    let clouds = topics_of(recording, |kind| kind == ReadingKind::Cloud);
    if !wanted.is_empty() {
        scans.extend(clouds);
        return wanted.iter().map(|topic| named(recording, &scans, "scans", topic)).collect();
    }
    let name = recording.name().to_owned();
    match if scans.is_empty() { clouds } else { scans }.as_slice() {
        [(only, _)] => Ok(vec![*only]),
        [] => {
            let all: Vec<String> = recording
                .topics()
                .iter()
                .map(|topic| format!("{} ({}, {})", topic.name, topic.type_name, topic.messages))
                .collect();
            let topics = if all.is_empty() { "there are none".to_owned() } else { all.join(", ") };
            Err(ReadRecordingError::NoScan { name, topics })
        }
        several => Err(ReadRecordingError::SeveralScans { name, topics: names(&several.to_vec()) }),
    }
}

fn chosen_odometry(recording: &Recording, wanted: Option<&str>) -> Result<Option<usize>, ReadRecordingError> {
    let found = topics_of(recording, |kind| kind == ReadingKind::Odometry);
    match (wanted, found.as_slice()) {
        (Some(topic), _) => named(recording, &found, "odometry", topic).map(Some),
        (None, []) => Ok(None),
        (None, [(only, _)]) => Ok(Some(*only)),
        (None, _) => {
            let name = recording.name().to_owned();
            Err(ReadRecordingError::SeveralOdometries { name, topics: names(&found) })
        }
    }
}
