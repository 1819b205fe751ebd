//! Reads the scans of a recording, each with the lidar's place on the robot and with its odometry.

use super::topic_choice::{ReadRecordingError, TopicChoice};
use crate::carmen::{Rejection, Tally};
use crate::scan_locator::{ScanLocator, Sighting};
use crate::settings::Settings;
use flockslam_messages::ScanBuffer;
use flockslam_recordings::{MessageProblem, Reading, Recording, RecordingError, TopicReading};
use std::collections::BTreeMap;
use std::path::Path;

/// So many messages that do not match their types are tolerated in any recording.
const BAD_MESSAGES_TOLERATED: f64 = 10.0;

/// A topic that ends this long before the recording has ended early, nanoseconds.
const EARLY_NS: i64 = 5_000_000_000;

/// Scans of a recording in its order, those of the chosen topics.
pub struct RecordingReader {
    recording: Recording,
    choice: TopicChoice,
    locator: ScanLocator,
    at_end: bool,
    /// By the number of the lidar.
    last_stamps_ns: BTreeMap<u32, i64>,
    /// When the last message of each topic was recorded, by its number.
    last_recorded_ns: BTreeMap<usize, i64>,
    max_bad_share: f64,
    /// Of a recording of a set: the number of the next scan, when none is missing.
    next_recorded: Option<u64>,
    tally: Tally,
}

impl RecordingReader {
    /// Opens a recording and chooses what is read of it.
    ///
    /// # Errors
    /// When it cannot be read, or it is not clear which scans or which odometry are meant.
    pub fn open(path: &Path, settings: &Settings) -> Result<Self, ReadRecordingError> {
        let mut recording = Recording::open(path)?;
        let choice = TopicChoice::of(&recording, settings)?;
        recording.want(&choice.all(&recording));
        let lidars = choice.scans.len();
        Ok(Self {
            locator: ScanLocator::new(settings, lidars, settings.imu_topic.is_some()),
            recording,
            choice,
            at_end: false,
            last_stamps_ns: BTreeMap::new(),
            last_recorded_ns: BTreeMap::new(),
            max_bad_share: settings.max_bad_line_share,
            next_recorded: None,
            tally: Tally::default(),
        })
    }

    /// The topics of the scans, by the number of the lidar.
    pub fn scan_topics(&self) -> impl Iterator<Item = &str> {
        self.choice.scans.iter().map(|topic| self.recording.topics()[*topic].name.as_str())
    }

    /// Number of scans that the recording announces.
    pub fn expected_scans(&self) -> u64 {
        self.choice.scans.iter().map(|topic| self.recording.topics()[*topic].messages).sum()
    }

    /// What was met so far; a message is a line.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Why the recording ended before its end, once that was met.
    pub fn cut_short(&self) -> Option<&str> {
        self.recording.cut_short()
    }

    /// Of topics that ended long before the recording, once that was read: which, and what it means. A line for each.
    pub fn ended_early(&self) -> Vec<String> {
        let Some(end_ns) = self.last_recorded_ns.values().max() else { return Vec::new() };
        let early = |topic: usize, meaning: &str| {
            let missing_ns = end_ns - self.last_recorded_ns.get(&topic)?;
            let name = &self.recording.topics()[topic].name;
            let missing_s = missing_ns as f64 * 1e-9;
            (missing_ns > EARLY_NS)
                .then(|| format!("{name} ends {missing_s:.1} s before the recording: {meaning}"))
        };
        let of_scans = match self.choice.scans.len() {
            1 => "the map ends there; --scan chooses another lidar",
            _ => "from there on the other lidars alone map",
        };
        let of_odometry = "from there on scans alone tell how the robot moves; --odom chooses other odometry";
        let scans = self.choice.scans.iter().map(|topic| early(*topic, of_scans));
        scans.chain(self.choice.odometry.map(|topic| early(topic, of_odometry))).flatten().collect()
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
                let before = std::mem::replace(scan, located);
                self.recording.take_back(before.numbers);
                self.count(scan);
                return Ok(true);
            }
            if self.at_end {
                return Ok(false);
            }
            let Some(next) = self.recording.next_reading()? else {
                self.at_end = true;
                continue;
            };
            self.tally.lines += 1;
            let TopicReading { topic, recorded_ns, .. } = next;
            self.last_recorded_ns.insert(topic, recorded_ns);
            let reading = match next.reading {
                Ok(reading) => reading,
                Err(problem) => {
                    self.tolerate(topic, problem)?;
                    continue;
                }
            };
            match reading {
                Reading::Scan(scan) => self.push(topic, recorded_ns, Sighting::Scan(scan)),
                Reading::Cloud(cloud) => self.push(topic, recorded_ns, Sighting::Cloud(cloud)),
                Reading::BusScan(recorded) => {
                    self.note_gap(recorded.header.id.sequence);
                    *scan = recorded;
                    self.count(scan);
                    return Ok(true);
                }
                // Only a run as it was has a use for them.
                Reading::SetRecord(_) => {}
                Reading::Imu(imu) => self.locator.push_imu(recorded_ns, imu),
                Reading::Odometry(odometry) => self.locator.push_odometry(recorded_ns, &odometry),
                Reading::Transforms(transforms) => {
                    let is_static = self.recording.topics()[topic].name.ends_with("tf_static");
                    self.locator.push_transforms(recorded_ns, &transforms, is_static);
                }
            }
        }
    }

    /// Counts a message that does not match its type; too many of them mean another kind of file.
    fn tolerate(&mut self, topic: usize, problem: MessageProblem) -> Result<(), RecordingError> {
        let bad = self.tally.rejected.entry(Rejection::BadMessage).or_default();
        *bad += 1;
        let tolerated = (self.max_bad_share * self.tally.lines as f64).max(BAD_MESSAGES_TOLERATED);
        if *bad as f64 <= if self.max_bad_share > 0.0 { tolerated } else { 0.0 } {
            return Ok(());
        }
        let name = self.recording.name().to_owned();
        let topic = self.recording.topics()[topic].name.clone();
        Err(RecordingError::Message { name, number: self.tally.lines, topic, bad: *bad, problem })
    }

    /// Takes note of scans that a recorder missed.
    fn note_gap(&mut self, sequence: u64) {
        let expected = self.next_recorded.unwrap_or(sequence);
        self.tally.missing += sequence.saturating_sub(expected);
        self.next_recorded = Some(sequence + 1);
    }

    fn push(&mut self, topic: usize, recorded_ns: i64, sighting: Sighting) {
        if let Some(lidar) = self.choice.scans.iter().position(|scans| *scans == topic) {
            self.locator.push_sighting(recorded_ns, lidar as u32, sighting);
        }
    }

    fn count(&mut self, scan: &mut ScanBuffer) {
        scan.header.id.sequence = self.tally.scans;
        self.tally.scans += 1;
        let stamp_ns = scan.header.times.sensor_ns;
        let last_ns = self.last_stamps_ns.insert(scan.header.id.lidar, stamp_ns);
        self.tally.steps_backward += u64::from(last_ns.is_some_and(|last| stamp_ns <= last));
    }
}
