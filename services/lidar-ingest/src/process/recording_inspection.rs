//! What is in a recording or a log, what would be read of it, and what it lacks.

use super::recording_reader::RecordingReader;
use super::topic_choice::TopicChoice;
use crate::carmen::CarmenReader;
use crate::settings::Settings;
use flockslam_calibration::BodyMask;
use flockslam_messages::ScanBuffer;
use flockslam_recordings::{Reading, Recording, is_recording};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// What is in a recording or a log.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Inspection {
    /// The file or folder.
    pub name: String,
    /// Number of its files.
    pub files: usize,
    /// Their size together, bytes.
    pub bytes: u64,
    /// When its first message was recorded, seconds since 1970; of a log: the stamp of its first scan.
    pub begins_s: f64,
    /// From its first message to its last, seconds.
    pub duration_s: f64,
    /// Topics; none in a log.
    pub topics: Vec<TopicSummary>,
    /// Those whose scans would be read.
    pub lidars: Vec<LidarSummary>,
    /// Where odometry would be read from.
    pub odometry: Option<String>,
    /// Share of the scans that would have odometry.
    pub odometry_share: f64,
    /// Share of the scans that would have the heading of a gyroscope in its place.
    pub gyro_share: f64,
    /// Transforms.
    pub transforms: Vec<TransformSummary>,
    /// Messages and lines that would be left out, by reason.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Why it ends before its end.
    pub cut_short: Option<String>,
    /// What is missing, and what to do about it.
    pub lacks: Vec<String>,
    /// Boxes around what the lidars see of the robot itself, for `lidar_ingest.self_mask`, where they were to be learned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub self_mask: Option<Vec<[f64; 4]>>,
}

/// A topic.
#[derive(Clone, Debug, Serialize)]
pub struct TopicSummary {
    /// Its name.
    pub name: String,
    /// The type of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Number of its messages.
    pub messages: u64,
    /// Messages a second, where they are understood.
    pub rate_hz: Option<f64>,
    /// The longest time between two of them, seconds.
    pub longest_gap_s: Option<f64>,
    /// What they would be used for.
    pub used_as: Option<String>,
}

/// A lidar, by its scans.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LidarSummary {
    /// The topic; of a log its name.
    pub topic: String,
    /// Number of scans.
    pub scans: u64,
    /// Least and greatest number of beams.
    pub beams: [u32; 2],
    /// From the first beam to the last of the first scan, degrees.
    pub field_of_view_deg: f64,
    /// Limits of the first scan, metres.
    pub range_m: [f32; 2],
    /// Share of the beams that return.
    pub returns: f64,
    /// From the first beam to the last of the first scan, seconds.
    pub sweep_s: f64,
    /// Place at the first scan: ahead of the middle of the robot and to its left, metres, and heading, degrees.
    pub base_from_laser: [f64; 3],
    /// Angles are counted clockwise as seen from above.
    pub clockwise: bool,
}

/// A frame in another.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct TransformSummary {
    /// The frame that it is in.
    pub parent: String,
    /// The frame.
    pub child: String,
    /// It is logged only once.
    pub is_static: bool,
}

/// Reads a recording or a log to its end. `learns_mask`: it also finds what the lidars see of the robot itself.
///
/// # Errors
/// One line, when it cannot be opened.
pub fn inspect(path: &Path, settings: &Settings, learns_mask: bool) -> Result<Inspection, String> {
    let mut found = Inspection { name: path.display().to_string(), ..Inspection::default() };
    if is_recording(path) {
        inspect_recording(&mut found, path, settings, learns_mask)?;
    } else {
        inspect_log(&mut found, path, settings, learns_mask)?;
    }
    if found.lacks.is_empty() && found.odometry_share == 0.0 {
        let instead = if found.gyro_share > 0.0 { "scans and a gyroscope" } else { "scans" };
        found.lacks.push(format!("no odometry: {instead} alone tell how the robot moves"));
    }
    Ok(found)
}

fn inspect_recording(
    found: &mut Inspection,
    path: &Path,
    settings: &Settings,
    learns_mask: bool,
) -> Result<(), String> {
    let mut recording = Recording::open(path).map_err(|error| error.to_string())?;
    found.files = recording.files().len();
    found.bytes = size(recording.files());
    let choice = TopicChoice::of(&recording, settings);
    let problem = messages(found, &mut recording, choice.as_ref().ok());
    let placed = choice.and_then(|_| placed_scans(found, path, settings, learns_mask));
    found.lacks.extend(placed.err().map(|error| error.to_string()).or(problem));
    Ok(())
}

/// Everything that is understood in a recording, as it was recorded; what stops the reading.
fn messages(
    found: &mut Inspection,
    recording: &mut Recording,
    choice: Option<&TopicChoice>,
) -> Option<String> {
    let all: Vec<usize> = (0..recording.topics().len()).collect();
    recording.want(&all);
    let mut times = vec![Times::default(); all.len()];
    let mut whole = Times::default();
    let mut transforms = BTreeMap::new();
    let problem = loop {
        let next = match recording.next_reading() {
            Ok(Some(next)) => next,
            Ok(None) => break None,
            Err(error) => break Some(error.to_string()),
        };
        times[next.topic].add(next.recorded_ns);
        whole.add(next.recorded_ns);
        let Ok(Reading::Transforms(stamped)) = next.reading else { continue };
        let is_static = recording.topics()[next.topic].name.ends_with("tf_static");
        for transform in stamped {
            transforms.insert((transform.parent, transform.child), is_static);
        }
    };
    (found.begins_s, found.duration_s) = (seconds(whole.first_ns), seconds(whole.last_ns - whole.first_ns));
    found.cut_short = recording.cut_short().map(str::to_owned);
    found.transforms = transforms
        .into_iter()
        .map(|((parent, child), is_static)| TransformSummary { parent, child, is_static })
        .collect();
    found.topics = recording
        .topics()
        .iter()
        .zip(&times)
        .enumerate()
        .map(|(at, (topic, times))| TopicSummary {
            name: topic.name.clone(),
            type_name: topic.type_name.clone(),
            messages: topic.messages,
            rate_hz: times.rate_hz(),
            longest_gap_s: (times.count > 1).then(|| seconds(times.longest_ns)),
            used_as: choice.and_then(|choice| choice.use_of(at, topic)),
        })
        .collect();
    let odometry = choice.and_then(|choice| choice.odometry).map(|at| recording.topics()[at].name.clone());
    found.odometry = odometry;
    problem
}

/// The scans as they would be read.
fn placed_scans(
    found: &mut Inspection,
    path: &Path,
    settings: &Settings,
    learns_mask: bool,
) -> Result<(), super::topic_choice::ReadRecordingError> {
    let mut reader = RecordingReader::open(path, settings)?;
    found.lidars = reader.scan_topics().map(LidarSummary::of_topic).collect();
    let mut scan = ScanBuffer::default();
    let mut tally = ScanTally { learns_mask, ..ScanTally::default() };
    let outcome = loop {
        match reader.next_scan(&mut scan) {
            Ok(true) => tally.add(found, &scan),
            Ok(false) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    tally.finish(found);
    found.rejected = reader.tally().rejected.iter().map(|(reason, count)| (reason.name(), *count)).collect();
    found.lacks.extend(reader.ended_early());
    let missing = reader.tally().missing;
    found.lacks.extend((missing > 0).then(|| format!("{missing} scans that the recorder missed")));
    if found.odometry.is_none() && found.odometry_share > 0.0 {
        found.odometry = Some("transforms".to_owned());
    }
    outcome
}

fn inspect_log(
    found: &mut Inspection,
    path: &Path,
    settings: &Settings,
    learns_mask: bool,
) -> Result<(), String> {
    let file = File::open(path).map_err(|error| format!("{}: {error}", path.display()))?;
    (found.files, found.bytes) = (1, size(&[path.to_owned()]));
    let mut reader = CarmenReader::new(BufReader::new(file), path.display().to_string(), settings.clone());
    found.lidars = vec![LidarSummary::of_topic("CARMEN lines")];
    let (mut scan, mut times) = (ScanBuffer::default(), Times::default());
    let mut tally = ScanTally { learns_mask, ..ScanTally::default() };
    loop {
        match reader.next_scan(&mut scan) {
            Ok(true) => {
                times.add(scan.header.times.sensor_ns);
                tally.add(found, &scan);
            }
            Ok(false) => break,
            Err(error) => {
                found.lacks.push(error.to_string());
                break;
            }
        }
    }
    (found.begins_s, found.duration_s) = (seconds(times.first_ns), seconds(times.last_ns - times.first_ns));
    tally.finish(found);
    found.odometry = (found.odometry_share > 0.0).then(|| "in the lines of the scans".to_owned());
    found.rejected = reader.tally().rejected.iter().map(|(reason, count)| (reason.name(), *count)).collect();
    Ok(())
}

fn size(files: &[PathBuf]) -> u64 {
    files.iter().filter_map(|file| file.metadata().ok()).map(|metadata| metadata.len()).sum()
}

fn seconds(ns: i64) -> f64 {
    ns as f64 * 1e-9
}

/// Times of messages.
#[derive(Clone, Copy, Debug, Default)]
struct Times {
    count: u64,
    first_ns: i64,
    last_ns: i64,
    longest_ns: i64,
}

impl Times {
    fn add(&mut self, at_ns: i64) {
        if self.count == 0 {
            (self.first_ns, self.last_ns) = (at_ns, at_ns);
        }
        self.count += 1;
        self.longest_ns = self.longest_ns.max(at_ns - self.last_ns);
        self.last_ns = self.last_ns.max(at_ns);
    }

    fn rate_hz(&self) -> Option<f64> {
        let duration_s = seconds(self.last_ns - self.first_ns);
        (self.count > 1 && duration_s > 0.0).then(|| (self.count - 1) as f64 / duration_s)
    }
}

impl LidarSummary {
    fn of_topic(topic: &str) -> Self {
        Self { topic: topic.to_owned(), ..Self::default() }
    }

    fn add_first(&mut self, scan: &ScanBuffer) {
        let header = &scan.header;
        let Ok(view) = scan.view() else { return };
        let place = header.base_from_laser;
        self.beams = [header.beam_count; 2];
        self.range_m = [header.range_min_m, header.range_max_m];
        self.base_from_laser = [place.x_m, place.y_m, place.heading_rad.to_degrees()];
        self.clockwise = header.angle_increment_rad < 0.0;
        if let Some(last) = view.len().checked_sub(1) {
            self.field_of_view_deg = (view.angle_rad(last) - view.angle_rad(0)).abs().to_degrees();
            self.sweep_s = view.time_s(last);
        }
    }
}

/// Sums over scans.
#[derive(Debug, Default)]
struct ScanTally {
    scans: u64,
    with_odometry: u64,
    with_gyro: u64,
    /// Beams and returns of each lidar.
    beams: BTreeMap<usize, (u64, u64)>,
    learns_mask: bool,
    masks: BTreeMap<usize, BodyMask>,
}

impl ScanTally {
    fn add(&mut self, found: &mut Inspection, scan: &ScanBuffer) {
        let at = scan.header.id.lidar as usize;
        let (Some(lidar), Ok(view)) = (found.lidars.get_mut(at), scan.view()) else { return };
        if lidar.scans == 0 {
            lidar.add_first(scan);
        }
        lidar.scans += 1;
        let [least, greatest] = lidar.beams;
        lidar.beams = [least.min(scan.header.beam_count), greatest.max(scan.header.beam_count)];
        let returns = (0..view.len()).filter(|beam| view.valid_range_m(*beam).is_some()).count();
        let (beams, returned) = self.beams.entry(at).or_default();
        *beams += view.len() as u64;
        *returned += returns as u64;
        if self.learns_mask {
            self.masks.entry(at).or_default().push(view);
        }
        self.scans += 1;
        self.with_odometry += u64::from(view.odometry().is_some());
        self.with_gyro += u64::from(view.gyro_heading_rad().is_some());
    }

    fn finish(&self, found: &mut Inspection) {
        for (at, (beams, returned)) in &self.beams {
            found.lidars[*at].returns = share(*returned, *beams);
        }
        found.odometry_share = share(self.with_odometry, self.scans);
        found.gyro_share = share(self.with_gyro, self.scans);
        if self.learns_mask {
            let learned: Result<Vec<_>, _> = self.masks.values().map(BodyMask::boxes).collect();
            match learned {
                Ok(boxes) => found.self_mask = Some(boxes.concat()),
                Err(error) => found.lacks.push(format!("no mask: {error}")),
            }
        }
        if self.scans > 0 && self.beams.values().all(|(_, returned)| *returned == 0) {
            found.lacks.push("no beam of any scan returns: are the limits of the ranges right?".to_owned());
        }
    }
}

fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 / whole as f64 }
}
