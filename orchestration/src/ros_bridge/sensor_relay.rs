//! Hands what sensors publish in the graph to lidar-ingest: scans with where their lidar sits, odometry by `/tf`, rates of turning.

use super::sensor_messages::{imu_of, odometry_of, scan_of, transforms_of};
use flockslam_ros::messages::{Imu, LaserScan, Odometry, TFMessage};
use flockslam_sensor_stream::{FramedScan, ImuReading, LidarScan, OdometryReading, Producer, SensorFrame};
use flockslam_transforms::{
    Isometry3, LookupError, Mounting, StampedTransform, TimeWatch, TransformBuffer, frame_name,
};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::Path;
use std::time::{Duration, Instant};

/// A scan waits so long for a transform to its lidar: robots publish these once a second or more often.
const PLACE_WAIT: Duration = Duration::from_secs(2);
/// Scans that wait.
const WAITING_MAX: usize = 64;
/// Frames without a place, and lines that were logged, are kept up to this number: names may come without end.
const NAMES_MAX: usize = 256;
/// A frame that lidar-ingest does not take within this is lost.
const WRITE_TIMEOUT: Duration = Duration::from_millis(50);
/// A scan whose stamp is farther from the clock of the graph is reported, nanoseconds.
const APART_NS: i64 = 10_000_000_000;
/// The clock of a simulation follows scans that show that time has gone back within this.
const CLOCK_WAIT: Duration = Duration::from_secs(1);
/// A scan without a pose after this is not waited for any more.
const POSE_WAIT: Duration = Duration::from_millis(500);

/// Hands sensor data on.
pub struct SensorRelay {
    producer: Producer,
    map_frame: String,
    odom_frame: String,
    base_frame: String,
    /// Odometry comes on a topic of its own.
    has_odometry_topic: bool,
    transforms: TransformBuffer,
    /// Until when odometry was handed on, nanoseconds.
    odometry_until_ns: i64,
    waiting: VecDeque<Waiting>,
    /// Where each lidar sat last, by its frame.
    places: BTreeMap<String, Isometry3<f64>>,
    /// Stamps of scans whose pose is awaited, and when they came.
    on_the_way: VecDeque<(i64, Instant)>,
    /// Frames for whose place was waited in vain.
    placeless: BTreeSet<String>,
    logged: BTreeSet<String>,
    /// The time of the scans of each topic.
    times: BTreeMap<String, TimeWatch>,
    /// When that of one went back.
    went_back: Option<Instant>,
    /// What became of scans.
    pub counts: RelayCounts,
}

struct Waiting {
    topic: String,
    scan: FramedScan,
    received: Instant,
    /// The version of the links with which nothing led to its frame.
    unlinked_at: Option<u64>,
}

/// What became of scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RelayCounts {
    /// Handed on.
    pub relayed: u64,
    /// No transform leads to their lidar, or it is tilted.
    pub unplaced: u64,
    /// They are no scans.
    pub malformed: u64,
    /// Nobody took them.
    pub untaken: u64,
    /// Their stamps are far from the clock of the graph.
    pub apart: u64,
}

/// Somebody else says where the frame of odometry is in the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ForeignCorrection;

impl SensorRelay {
    /// A relay to the socket at `path`, for a robot with these frames.
    pub fn new(
        path: &Path,
        map_frame: &str,
        odom_frame: &str,
        base_frame: &str,
        has_odometry_topic: bool,
    ) -> Self {
        Self {
            producer: Producer::new(path, Some(WRITE_TIMEOUT)),
            map_frame: frame_name(map_frame).to_owned(),
            odom_frame: frame_name(odom_frame).to_owned(),
            base_frame: frame_name(base_frame).to_owned(),
            has_odometry_topic,
            transforms: TransformBuffer::live(),
            odometry_until_ns: i64::MIN,
            waiting: VecDeque::new(),
            places: BTreeMap::new(),
            on_the_way: VecDeque::new(),
            placeless: BTreeSet::new(),
            logged: BTreeSet::new(),
            times: BTreeMap::new(),
            went_back: None,
            counts: RelayCounts::default(),
        }
    }

    /// The transforms of the graph.
    pub fn transforms(&self) -> &TransformBuffer {
        &self.transforms
    }

    /// Whether the time of the scans of a topic goes back to this stamp.
    pub fn goes_back(&mut self, topic: &str, stamp_ns: i64) -> bool {
        let goes_back = match self.times.get_mut(topic) {
            Some(time) => time.goes_back(stamp_ns),
            None => self.times.entry(topic.to_owned()).or_default().goes_back(stamp_ns),
        };
        self.went_back = goes_back.then(Instant::now).or(self.went_back);
        goes_back
    }

    /// Takes a scan; `now_ns` by the clock of the graph.
    pub fn take_scan(&mut self, topic: &str, message: LaserScan, received: Instant, now_ns: Option<i64>) {
        let claimed_s = message.time_increment;
        let scan = match scan_of(message) {
            Ok(scan) => scan,
            Err(problem) => {
                self.counts.malformed += 1;
                return self.warn_once(format!("{topic}: a scan is left out: {problem}"));
            }
        };
        if claimed_s != 0.0 && scan.scan.header.time_increment_s == 0.0 {
            self.warn_once(format!(
                "{topic}: a time_increment of {claimed_s} s cannot be: scans count as taken at one time"
            ));
        }
        let stamp_ns = scan.scan.header.times.sensor_ns;
        let gap_ns = now_ns.map_or(0, |now_ns| stamp_ns.saturating_sub(now_ns));
        // The clock may follow a scan that shows that time has gone back.
        let is_open = self.times.get(topic).is_some_and(TimeWatch::is_behind)
            || self.went_back.is_some_and(|at| at.elapsed() < CLOCK_WAIT);
        if gap_ns.saturating_abs() > APART_NS && !is_open {
            self.counts.apart += 1;
            let which = if gap_ns < 0 { "behind" } else { "ahead of" };
            let gap_s = gap_ns.unsigned_abs() as f64 * 1e-9;
            self.warn_once(format!("{topic}: its stamps are {gap_s:.1} s {which} the clock of the graph; for a recording or a simulation set use_sim_time"));
        }
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
            self.counts.unplaced += 1;
        }
        self.waiting.push_back(Waiting { topic: topic.to_owned(), scan, received, unlinked_at: None });
        self.relay_scans();
    }

    /// Takes transforms. Whoever else corrects odometry is named, and not used.
    pub fn take_transforms(&mut self, message: TFMessage, is_static: bool) -> Option<ForeignCorrection> {
        let mut foreign = None;
        for transform in transforms_of(message) {
            let [parent, child] = [&transform.parent, &transform.child].map(|name| frame_name(name));
            if child == self.odom_frame && parent == self.map_frame {
                foreign = Some(ForeignCorrection);
                continue;
            }
            self.transforms.insert(&transform, is_static);
            if !self.has_odometry_topic {
                self.relay_odometry();
            }
        }
        self.relay_scans();
        foreign
    }

    /// Takes odometry from a topic.
    pub fn take_odometry(&mut self, message: Odometry) {
        if let Some(reading) = odometry_of(message) {
            self.send(&SensorFrame::Odometry(reading));
        }
    }

    /// Takes what an IMU says, turned into the frame of the robot.
    pub fn take_imu(&mut self, message: Imu) {
        let Some(reading) = imu_of(message) else { return };
        let turned = self.transforms.lookup(&self.base_frame, &reading.frame, reading.stamp_ns);
        let turned = turned.map(|base_from_imu| base_from_imu.rotation).unwrap_or_default();
        let turn_rad_s = turned * reading.turn_rad_s;
        self.send(&SensorFrame::Imu(ImuReading { frame: self.base_frame.clone(), turn_rad_s, ..reading }));
    }

    /// Hands on what has waited for its time.
    pub fn tick(&mut self) {
        self.relay_scans();
        while self.on_the_way.front().is_some_and(|(_, received)| received.elapsed() > POSE_WAIT) {
            self.on_the_way.pop_front();
        }
    }

    /// How long ago the scan came whose pose is awaited; `None` when none is.
    pub fn awaited_for(&self) -> Option<Duration> {
        self.on_the_way.back().map(|(_, received)| received.elapsed())
    }

    /// Whether a scan waits for its place.
    pub fn holds_scans(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// When the scan with this stamp came; it is not awaited any more.
    pub fn came(&mut self, stamp_ns: i64) -> Option<Instant> {
        let at = self.on_the_way.iter().position(|(known_ns, _)| *known_ns == stamp_ns)?;
        self.on_the_way.drain(..=at).next_back().map(|(_, received)| received)
    }

    /// Drops transforms that do not hold at all times, and what waits: time has gone back.
    pub fn clear(&mut self) {
        self.transforms.clear_moving();
        self.waiting.clear();
        self.on_the_way.clear();
        self.times.clear();
        self.odometry_until_ns = i64::MIN;
    }

    /// One line about a pose for which odometry is not known at its time.
    pub fn warn_without_odometry(&mut self, stamp_ns: i64) {
        let (odom, base) = (&self.odom_frame, &self.base_frame);
        let line = match self.transforms.known_until_ns(odom, base) {
            None if !self.transforms.links(odom, base) => format!(
                "map → {odom} is not published: nothing in /tf connects '{odom}' with '{base}'; set odom_frame and base_frame, or \
                 publish_odom_transform for a robot without odometry"
            ),
            None => return,
            Some(until_ns) => {
                let gap_s = (stamp_ns.saturating_sub(until_ns)) as f64 * 1e-9;
                let which = if gap_s > 0.0 { "before" } else { "after" };
                format!(
                    "map → {odom}: at the stamp of a scan '{odom}' → '{base}' is not known; its newest transform is {:.3} s {which} the scan",
                    gap_s.abs()
                )
            }
        };
        self.warn_once(line);
    }

    fn relay_odometry(&mut self) {
        let (odom, base) = (&self.odom_frame, &self.base_frame);
        let Some(until_ns) = self.transforms.known_until_ns(odom, base) else { return };
        if until_ns <= self.odometry_until_ns {
            return;
        }
        let Ok(parent_from_child) = self.transforms.lookup(odom, base, until_ns) else { return };
        self.odometry_until_ns = until_ns;
        let (parent, child) = ("odom".to_owned(), "base_link".to_owned());
        let transform = StampedTransform { stamp_ns: until_ns, parent, child, parent_from_child };
        self.send(&SensorFrame::Odometry(OdometryReading { transform, twist: None }));
    }

    fn relay_scans(&mut self) {
        let links_version = self.transforms.links_version();
        let mut index = 0;
        while let Some(next) = self.waiting.get(index) {
            let stamp_ns = next.scan.scan.header.times.sensor_ns;
            let waits = next.received.elapsed() < PLACE_WAIT && !self.placeless.contains(&next.scan.frame);
            // Transforms may come ten thousand times a second.
            if waits && next.unlinked_at == Some(links_version) {
                index += 1;
                continue;
            }
            let place = match self.place(&next.scan.frame, stamp_ns) {
                Ok(place) => place,
                Err(error) if waits => {
                    // Those of other lidars behind it do not wait for it.
                    self.waiting[index].unlinked_at =
                        (error == LookupError::Unlinked).then_some(links_version);
                    index += 1;
                    continue;
                }
                // No mounting is given: the lidar's frame is the base frame.
                Err(_) if self.transforms.is_empty() => Isometry3::identity(),
                Err(error) => {
                    let (topic, frame) = (next.topic.clone(), next.scan.frame.clone());
                    self.waiting.remove(index);
                    self.counts.unplaced += 1;
                    if self.placeless.len() == NAMES_MAX {
                        self.placeless.clear();
                    }
                    self.placeless.insert(frame.clone());
                    self.warn_unplaced(&topic, &frame, error);
                    continue;
                }
            };
            let Some(Waiting { topic, mut scan, received, .. }) = self.waiting.remove(index) else { return };
            match Mounting::from_transform(&place) {
                Ok(mounting) => scan.mounting = Some(mounting),
                Err(tilted) => {
                    self.counts.unplaced += 1;
                    self.warn_once(format!("{topic}: scans are left out: in '{}' {tilted}, and they do not lie in the plane that the robot drives in", scan.frame));
                    continue;
                }
            }
            self.places.insert(scan.frame.clone(), place);
            let lidar = topic.clone();
            let sent = self.producer.send(&SensorFrame::Scan(LidarScan { lidar, scan }));
            match sent {
                Ok(()) => {
                    self.counts.relayed += 1;
                    self.on_the_way.push_back((stamp_ns, received));
                }
                Err(error) => {
                    self.counts.untaken += 1;
                    self.warn_once(format!(
                        "{topic}: scans are not taken: {error}; the set needs [source] kind = \"scans\""
                    ));
                }
            }
        }
    }

    /// `base_from_laser` at a time; where it is not known then, where it was last.
    fn place(&self, frame: &str, stamp_ns: i64) -> Result<Isometry3<f64>, LookupError> {
        let base = &self.base_frame;
        if frame_name(frame) == base {
            return Ok(Isometry3::identity());
        }
        self.transforms.lookup(base, frame, stamp_ns).or_else(|error| {
            let last = || {
                let until_ns = self.transforms.known_until_ns(base, frame)?;
                self.transforms.lookup(base, frame, until_ns).ok()
            };
            self.places.get(frame).copied().or_else(last).ok_or(error)
        })
    }

    fn warn_unplaced(&mut self, topic: &str, frame: &str, error: LookupError) {
        let base = self.base_frame.clone();
        let known = |name: &str| if self.transforms.knows(name) { "known" } else { "not known" };
        self.warn_once(format!(
            "{topic}: scans are left out: nothing in /tf and /tf_static leads from '{base}' ({}) to '{frame}' ({}): {error}; base_frame \
             says what the robot's frame is called",
            known(&base),
            known(frame)
        ));
    }

    fn send(&mut self, frame: &SensorFrame) {
        // What is lost here is counted with scans, which are lost with it.
        let _ = self.producer.send(frame);
    }

    /// Each line is logged once.
    fn warn_once(&mut self, line: String) {
        // Figures differ from line to line.
        let kind: String = line.chars().filter(|c| !c.is_ascii_digit()).collect();
        if self.logged.len() < NAMES_MAX && self.logged.insert(kind) {
            tracing::warn!("{line}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_ros::messages::{Header, Quaternion, Transform, TransformStamped, Vector3};
    use flockslam_sensor_stream::FrameReader;
    use std::io::Read;
    use std::os::unix::net::{UnixListener, UnixStream};

    const MS: i64 = 1_000_000;

    fn transform(stamp_ms: i64, parent: &str, child: &str, x: f64) -> TFMessage {
        let transform =
            Transform { translation: Vector3 { x, y: 0.0, z: 0.0 }, rotation: Quaternion::about_z(0.0) };
        let header = Header::new(stamp_ms * MS, parent);
        TFMessage {
            transforms: vec![TransformStamped { header, child_frame_id: child.to_owned(), transform }],
        }
    }

    fn scan(stamp_ms: i64) -> LaserScan {
        LaserScan {
            header: Header::new(stamp_ms * MS, "laser"),
            angle_increment: 0.5,
            range_max: 10.0,
            ranges: vec![1.0, 2.0],
            ..LaserScan::default()
        }
    }

    struct Ingest {
        stream: UnixStream,
        reader: FrameReader,
    }

    impl Ingest {
        fn frames(&mut self, count: usize) -> Vec<SensorFrame> {
            let (mut found, mut bytes) = (Vec::new(), [0; 4096]);
            while found.len() < count {
                let length = self.stream.read(&mut bytes).unwrap();
                self.reader.push(&bytes[..length]);
                found.extend(std::iter::from_fn(|| self.reader.next_frame()).map(Result::unwrap));
            }
            found
        }
    }

    fn relay() -> (SensorRelay, Ingest, tempfile::TempDir) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("scans");
        let listener = UnixListener::bind(&path).unwrap();
        let mut relay = SensorRelay::new(&path, "map", "odom", "base", false);
        relay.producer.connect().unwrap();
        let ingest = Ingest { stream: listener.accept().unwrap().0, reader: FrameReader::default() };
        (relay, ingest, directory)
    }

    #[test]
    fn a_scan_goes_on_with_its_place_once_that_is_known() {
        let (mut relay, mut ingest, _directory) = relay();
        relay.take_scan("/scan", scan(100), Instant::now(), Some(100 * MS));
        assert!(relay.holds_scans() && relay.awaited_for().is_none());
        assert_eq!(relay.take_transforms(transform(0, "base", "laser", 0.3), true), None);
        let frames = ingest.frames(1);
        let SensorFrame::Scan(LidarScan { lidar, scan }) = &frames[0] else { panic!("{frames:?}") };
        assert_eq!((lidar.as_str(), scan.frame.as_str()), ("/scan", "laser"));
        assert!((scan.mounting.unwrap().base_from_laser.x_m - 0.3).abs() < 1e-9);
        assert!(relay.awaited_for().is_some());
        assert!(relay.came(100 * MS).is_some() && relay.awaited_for().is_none());
    }

    #[test]
    fn a_scan_in_an_unknown_frame_delays_no_other() {
        let (mut relay, mut ingest, _directory) = relay();
        relay.take_transforms(transform(0, "base", "laser", 0.3), true);
        let without_transform = LaserScan { header: Header::new(90 * MS, "nobody"), ..scan(90) };
        relay.take_scan("/scan", without_transform, Instant::now(), Some(90 * MS));
        relay.take_scan("/scan", scan(100), Instant::now(), Some(100 * MS));
        let frames = ingest.frames(1);
        let SensorFrame::Scan(LidarScan { scan, .. }) = &frames[0] else { panic!("{frames:?}") };
        assert_eq!((scan.frame.as_str(), relay.holds_scans()), ("laser", true));
    }

    #[test]
    fn odometry_is_the_pose_of_the_robot_in_tf() {
        let (mut relay, mut ingest, _directory) = relay();
        relay.take_transforms(transform(10, "odom", "footprint", 1.0), false);
        relay.take_transforms(transform(10, "footprint", "base", 0.5), true);
        relay.take_transforms(transform(20, "odom", "footprint", 2.0), false);
        // Out of order: it is known already.
        relay.take_transforms(transform(15, "odom", "footprint", 1.5), false);
        let found: Vec<_> = ingest
            .frames(2)
            .into_iter()
            .map(|frame| match frame {
                SensorFrame::Odometry(reading) => {
                    (reading.transform.stamp_ns / MS, reading.transform.parent_from_child.translation.x)
                }
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(found, [(10, 1.5), (20, 2.5)]);
    }

    #[test]
    fn a_foreign_odometry_correction_is_detected_and_not_used() {
        let (mut relay, _ingest, _directory) = relay();
        let noticed = relay.take_transforms(transform(10, "/map", "odom", 1.0), false);
        assert_eq!(noticed, Some(ForeignCorrection));
        assert!(!relay.transforms().knows("map"));
    }

    #[test]
    fn scans_that_cannot_be_placed_or_are_none_are_counted() {
        let (mut relay, _ingest, _directory) = relay();
        relay.take_transforms(transform(0, "odom", "base", 0.3), false);
        let long_ago = Instant::now() - 2 * PLACE_WAIT;
        relay.take_scan("/scan", scan(100), long_ago, Some(100 * MS));
        relay.take_scan("/scan", LaserScan { angle_min: f32::NAN, ..scan(200) }, long_ago, None);
        let of_a_ydlidar = LaserScan { time_increment: 153_333.0, ..scan(300) };
        relay.take_scan("/scan", of_a_ydlidar, long_ago, Some(3_600_000 * MS));
        let expected = RelayCounts { unplaced: 2, malformed: 1, apart: 1, ..RelayCounts::default() };
        assert_eq!(relay.counts, expected);
        assert_eq!(relay.logged.len(), 4);
    }
}
