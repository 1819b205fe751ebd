//! Gives the scans of a recording what they lack: where the lidar sits, and the pose of odometry at their time.
//!
//! Both come from messages of their own, which may be recorded later than the scan and out of order: scans wait for them, for a time
//! that is counted in the recording.

use crate::settings::LidarMounting;
use flockslam_geometry::Pose;
use flockslam_messages::ScanBuffer;
use flockslam_recordings::{FramedScan, OdometryReading};
use flockslam_transforms::{
    Isometry3, LookupError, Mounting, MountingError, StampedTransform, TransformBuffer, frame_name, planar,
};
use std::collections::VecDeque;

/// So long the first scan waits for transforms, nanoseconds: robots publish where their lidar sits once a second or more often.
const FIRST_WAIT_NS: i64 = 2_000_000_000;
/// So long each scan waits for odometry behind it, nanoseconds.
const WAIT_NS: i64 = 500_000_000;
/// Odometry that is that old is taken where none behind the scan comes, nanoseconds.
const ODOMETRY_AGE_NS: i64 = 100_000_000;
/// Names of the frame of the robot, by REP-105 and by use.
const BASE_FRAMES: [&str; 2] = ["base_link", "base_footprint"];

/// Why a scan cannot be placed on the robot.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LocateError {
    /// Transforms are there, and none leads to the lidar.
    #[error(
        "nothing in /tf and /tf_static leads from the robot to the lidar's frame '{frame}'; say where it sits: --set \
         'lidar_ingest.lidars=[{{x_m=0.2, y_m=0, heading_deg=0}}]'"
    )]
    Unlinked {
        /// The lidar's frame.
        frame: String,
    },
    /// It does not scan in the plane.
    #[error("the frame '{frame}': {problem}, and does not scan in the plane that the robot drives in")]
    Tilted {
        /// The lidar's frame.
        frame: String,
        /// By how much.
        problem: MountingError,
    },
}

/// Places scans on the robot, and in the frame of odometry, from transforms and odometry.
#[derive(Debug, Default)]
pub struct ScanLocator {
    /// What the settings say, whatever the transforms do.
    given: Option<Mounting>,
    transforms: TransformBuffer,
    /// Poses from messages of odometry.
    odometry: TransformBuffer,
    /// The frames that messages of odometry have: the fixed one, and that of the robot.
    odometry_frames: Option<(String, String)>,
    /// With the time at which each was recorded.
    waiting: VecDeque<(i64, FramedScan)>,
    /// When the last message was recorded, nanoseconds.
    newest_ns: i64,
    frames: Option<Frames>,
    /// Where the lidar sat at the scan before.
    last_mounting: Option<Mounting>,
}

/// Frames of a robot.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Frames {
    base: String,
    /// The lidar is linked to it.
    has_mounting: bool,
    /// Where transforms have odometry.
    odom: Option<String>,
}

impl ScanLocator {
    /// With what the settings say of the lidar.
    pub fn new(lidar: Option<&LidarMounting>) -> Self {
        Self { given: lidar.map(LidarMounting::mounting), newest_ns: i64::MIN, ..Self::default() }
    }

    /// Takes a scan that was recorded at this time.
    pub fn push_scan(&mut self, recorded_ns: i64, scan: FramedScan) {
        self.newest_ns = self.newest_ns.max(recorded_ns);
        self.waiting.push_back((recorded_ns, scan));
    }

    /// Takes odometry.
    pub fn push_odometry(&mut self, recorded_ns: i64, reading: &OdometryReading) {
        self.newest_ns = self.newest_ns.max(recorded_ns);
        let transform = &reading.transform;
        // Some drivers leave the names out.
        let name = |name: &str, missing: &str| match frame_name(name) {
            "" => missing.to_owned(),
            name => name.to_owned(),
        };
        let (parent, child) = (name(&transform.parent, "odom"), name(&transform.child, "base_link"));
        self.odometry_frames = Some((parent.clone(), child.clone()));
        self.odometry.insert(&StampedTransform { parent, child, ..transform.clone() }, false);
    }

    /// Takes transforms.
    pub fn push_transforms(&mut self, recorded_ns: i64, transforms: &[StampedTransform], is_static: bool) {
        self.newest_ns = self.newest_ns.max(recorded_ns);
        transforms.iter().for_each(|transform| self.transforms.insert(transform, is_static));
    }

    /// The next scan, placed; `None` while it waits for more. At the end nothing waits.
    ///
    /// # Errors
    /// When transforms do not say where the lidar sits, or say that it is tilted.
    pub fn take(&mut self, at_end: bool) -> Result<Option<ScanBuffer>, LocateError> {
        let Some((recorded_ns, front)) = self.waiting.front() else { return Ok(None) };
        let waited_ns = self.newest_ns.saturating_sub(*recorded_ns);
        let frame = frame_name(&front.frame).to_owned();
        let frames = match &self.frames {
            Some(frames) => frames.clone(),
            None if waited_ns < FIRST_WAIT_NS && !at_end => return Ok(None),
            None => self.frames.insert(self.choose_frames(&frame)).clone(),
        };
        let stamp_ns = front.scan.header.times.sensor_ns;
        let odometry = self.odometry_at(&frames, stamp_ns);
        if odometry == Err(LookupError::NotYet) && waited_ns < WAIT_NS && !at_end {
            return Ok(None);
        }
        let mounting = self.mounting(&frames, &frame, stamp_ns)?;
        self.last_mounting = Some(mounting);
        let odometry = odometry.ok().or_else(|| self.last_odometry(&frames, stamp_ns));
        let Some((_, located)) = self.waiting.pop_front() else { return Ok(None) };
        Ok(Some(placed(located.scan, mounting, odometry)))
    }

    fn choose_frames(&self, laser: &str) -> Frames {
        let child = self.odometry_frames.as_ref().map(|(_, child)| child.as_str());
        let linked = |base: &&str| *base == laser || self.transforms.links(base, laser);
        let candidates = || BASE_FRAMES.into_iter().chain(child);
        let linked = candidates().find(linked);
        let base = linked.or_else(|| candidates().find(|base| self.transforms.knows(base))).unwrap_or(laser);
        let ancestors = self.transforms.ancestors(base);
        Frames {
            base: base.to_owned(),
            has_mounting: linked.is_some(),
            odom: ancestors.into_iter().find(|frame| frame.contains("odom")).map(str::to_owned),
        }
    }

    fn mounting(&self, frames: &Frames, laser: &str, stamp_ns: i64) -> Result<Mounting, LocateError> {
        if let Some(given) = self.given {
            return Ok(given);
        }
        if !frames.has_mounting {
            // Nobody has said anything: the lidar is the robot.
            let is_silent = self.transforms.is_empty();
            let unlinked = || LocateError::Unlinked { frame: laser.to_owned() };
            return if is_silent { Ok(Mounting::MIDDLE) } else { Err(unlinked()) };
        }
        let transform = if frames.base == laser {
            Ok(Isometry3::identity())
        } else {
            let at_stamp = self.transforms.lookup(&frames.base, laser, stamp_ns);
            let until_ns = self.transforms.known_until_ns(&frames.base, laser);
            // What is published as if it moved, and is fixed, holds beyond its last message.
            let last = || self.transforms.lookup(&frames.base, laser, until_ns.unwrap_or(stamp_ns));
            at_stamp.or_else(|error| self.last_mounting.map_or_else(last, |_| Err(error)))
        };
        match transform {
            Ok(transform) => Mounting::from_transform(&transform)
                .map_err(|problem| LocateError::Tilted { frame: laser.to_owned(), problem }),
            Err(_) => self.last_mounting.ok_or(LocateError::Unlinked { frame: laser.to_owned() }),
        }
    }

    /// `odom_from_base` at a time.
    fn odometry_at(&self, frames: &Frames, at_ns: i64) -> Result<Pose, LookupError> {
        if let Some((parent, child)) = &self.odometry_frames {
            let moved = self.odometry.lookup(parent, child, at_ns)?;
            let base = self.transforms.lookup(child, &frames.base, at_ns);
            return Ok(planar(&(moved * base.unwrap_or_default())));
        }
        let odom = frames.odom.as_deref().ok_or(LookupError::Unlinked)?;
        self.transforms.lookup(odom, &frames.base, at_ns).map(|moved| planar(&moved))
    }

    /// The newest odometry, where it is not much older than a scan.
    fn last_odometry(&self, frames: &Frames, stamp_ns: i64) -> Option<Pose> {
        let known_until_ns = match (&self.odometry_frames, &frames.odom) {
            (Some((parent, child)), _) => self.odometry.known_until_ns(parent, child),
            (None, Some(odom)) => self.transforms.known_until_ns(odom, &frames.base),
            (None, None) => None,
        }?;
        let is_near = (0..=ODOMETRY_AGE_NS).contains(&stamp_ns.saturating_sub(known_until_ns));
        is_near.then(|| self.odometry_at(frames, known_until_ns).ok()).flatten()
    }
}

fn placed(mut scan: ScanBuffer, mounting: Mounting, odometry: Option<Pose>) -> ScanBuffer {
    let header = &mut scan.header;
    header.base_from_laser = mounting.base_from_laser;
    if mounting.upside_down {
        header.angle_min_rad = -header.angle_min_rad;
        header.angle_increment_rad = -header.angle_increment_rad;
    }
    if let Some(odometry) = odometry.filter(|pose| pose.is_finite()) {
        (header.odometry, header.has_odometry) = (odometry, 1);
    }
    scan
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn scan(stamp_ms: i64) -> FramedScan {
        let mut scan = ScanBuffer::from_ranges(&[1.0, 2.0], -0.5, 1.0);
        scan.header.times.sensor_ns = stamp_ms * MS;
        FramedScan { frame: "/laser".to_owned(), scan }
    }

    fn transform(stamp_ms: i64, parent: &str, child: &str, x_m: f64) -> StampedTransform {
        StampedTransform {
            stamp_ns: stamp_ms * MS,
            parent: parent.to_owned(),
            child: child.to_owned(),
            parent_from_child: Isometry3::translation(x_m, 0.0, 0.0),
        }
    }

    fn stamp_ms(scan: &ScanBuffer) -> i64 {
        scan.header.times.sensor_ns / MS
    }

    #[test]
    fn odometry_is_interpolated_at_the_time_of_the_scan_whatever_comes_first() {
        let mut locator = ScanLocator::new(None);
        locator.push_transforms(0, &[transform(0, "base_link", "laser", 0.3)], true);
        locator.push_scan(100 * MS, scan(100));
        locator.push_transforms(160 * MS, &[transform(150, "odom", "base_link", 1.5)], false);
        locator.push_transforms(170 * MS, &[transform(50, "odom", "base_link", 0.5)], false);
        assert_eq!(locator.take(false), Ok(None), "more may come");
        let found = locator.take(true).unwrap().unwrap();
        assert_eq!((found.header.base_from_laser.x_m, found.header.has_odometry), (0.3, 1));
        assert!((found.header.odometry.x_m - 1.0).abs() < 1e-12);
        assert_eq!(locator.take(true), Ok(None));
    }

    #[test]
    fn scans_wait_for_odometry_and_not_for_ever() {
        let mut locator = ScanLocator::new(None);
        let odometry = |at_ms: i64| OdometryReading { transform: transform(at_ms, "odom", "", 1.0) };
        locator.push_odometry(0, &odometry(0));
        locator.push_scan(10 * MS, scan(10));
        locator.push_scan(2100 * MS, scan(2100));
        let first = locator.take(false).unwrap().unwrap();
        assert_eq!((stamp_ms(&first), first.header.has_odometry), (10, 1), "the pose before is not too old");
        assert_eq!(locator.take(false), Ok(None));
        locator.push_scan(2700 * MS, scan(2700));
        let second = locator.take(false).unwrap().unwrap();
        assert_eq!((stamp_ms(&second), second.header.has_odometry), (2100, 0));
    }

    #[test]
    fn without_any_transform_the_lidar_is_the_robot_and_with_others_it_is_refused() {
        let mut locator = ScanLocator::new(None);
        locator.push_scan(0, scan(0));
        let alone = locator.take(true).unwrap().unwrap();
        assert_eq!((alone.header.base_from_laser, alone.header.has_odometry), (Pose::IDENTITY, 0));
        let mut locator = ScanLocator::new(None);
        locator.push_transforms(0, &[transform(0, "odom", "base_link", 0.0)], false);
        locator.push_scan(0, scan(0));
        let error = locator.take(true).unwrap_err().to_string();
        assert!(error.contains("'laser'") && error.contains("lidar_ingest.lidars"), "{error}");
        let given = LidarMounting { x_m: 0.2, upside_down: true, ..LidarMounting::default() };
        let mut locator = ScanLocator::new(Some(&given));
        locator.push_transforms(0, &[transform(0, "odom", "base_link", 0.0)], false);
        locator.push_scan(0, scan(0));
        let found = locator.take(true).unwrap().unwrap();
        assert_eq!(found.header.base_from_laser.x_m, 0.2);
        assert_eq!((found.header.angle_min_rad, found.header.angle_increment_rad), (0.5, -1.0));
    }
}
