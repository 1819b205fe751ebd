//! Gives the scans of a recording what they lack: where the lidar sits, and the pose of odometry at their time.
//!
//! Both come from messages of their own, which may be recorded later than the scan and out of order: scans wait for them, for a time
//! that is counted in the recording.

mod lidar_place;
mod robot_motion;

use lidar_place::Place;

use crate::cloud_slice::slice;
use crate::gyro_heading::GyroHeading;
use crate::lidar_order::LidarOrder;
use crate::settings::Settings;
use flockslam_geometry::{Pose, Twist};
use flockslam_messages::ScanBuffer;
use flockslam_recordings::FramedCloud;
use flockslam_sensor_stream::{FramedScan, ImuReading, OdometryReading};
use flockslam_transforms::{
    LookupError, Mounting, MountingError, StampedTransform, TransformBuffer, frame_name, planar,
};
use std::collections::{BTreeMap, VecDeque};

/// So long the first scan waits for transforms, nanoseconds: robots publish where their lidar sits once a second or more often.
const FIRST_WAIT_NS: i64 = 2_000_000_000;
/// So long each scan waits for odometry behind it, and for scans of other lidars before it, nanoseconds.
const WAIT_NS: i64 = 500_000_000;
/// Live, the first scan waits so long for transforms, nanoseconds …
const LIVE_FIRST_WAIT_NS: i64 = 1_000_000_000;
/// … and each for what belongs to it: later than this a pose is worth less than the time that it takes.
const LIVE_WAIT_NS: i64 = 50_000_000;
/// Live, motion of which nothing came for so long is not waited for, nanoseconds.
const SILENCE_NS: i64 = 500_000_000;
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

/// What a sensor has seen at once.
#[derive(Clone, Debug)]
pub enum Sighting {
    /// A scan in the lidar's own plane.
    Scan(FramedScan),
    /// Points in space.
    Cloud(FramedCloud),
}

impl Sighting {
    fn frame(&self) -> &str {
        frame_name(match self {
            Self::Scan(scan) => &scan.frame,
            Self::Cloud(cloud) => &cloud.frame,
        })
    }

    /// Its mounting from its driver.
    fn mounting(&self) -> Option<Mounting> {
        match self {
            Self::Scan(scan) => scan.mounting,
            Self::Cloud(_) => None,
        }
    }

    fn stamp_ns(&self) -> i64 {
        match self {
            Self::Scan(scan) => scan.scan.header.times.sensor_ns,
            Self::Cloud(cloud) => cloud.stamp_ns,
        }
    }
}

/// Places scans on the robot, and in the frame of odometry, from transforms and odometry.
#[derive(Debug, Default)]
pub struct ScanLocator {
    settings: Settings,
    /// Number of lidars whose scans come.
    lidars: usize,
    transforms: TransformBuffer,
    /// Poses from messages of odometry.
    odometry: TransformBuffer,
    /// The frames that messages of odometry have: the fixed one, and that of the robot.
    odometry_frames: Option<(String, String)>,
    gyro: GyroHeading,
    /// The gyro's turns replace those of odometry, not only missing ones.
    gyro_leads: bool,
    /// Raw odometry, the gyro's heading where it was known, and the pose by both, at the scan before.
    fused: Option<(Pose, Option<f64>, Pose)>,
    waiting: VecDeque<Waiting>,
    /// When the last message was recorded, nanoseconds.
    newest_ns: i64,
    /// The first scan waits until then for what has not come since it was looked at last, nanoseconds.
    waits_until_ns: Option<i64>,
    frames: Option<Frames>,
    /// Where each lidar sat at its scan before, by its number.
    last_places: BTreeMap<u32, Place>,
    /// Of live sensors: times are those of the clock at which they were received.
    live: Option<Live>,
}

/// What is known of live sensors.
#[derive(Debug, Default)]
struct Live {
    order: LidarOrder,
    /// When odometry, transforms or turns last came, nanoseconds.
    motion_ns: i64,
    /// Twist of the robot at the last odometry, where it was given.
    twist: Option<Twist>,
    guesses: MotionGuesses,
}

/// How often scans of live sensors did not get the pose by odometry at their time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotionGuesses {
    /// Odometry came too late: the pose was extrapolated by its twist.
    pub extrapolated: u64,
    /// Nothing near was known: the scan has no odometry.
    pub without: u64,
}

#[derive(Debug)]
struct Waiting {
    recorded_ns: i64,
    lidar: u32,
    sighting: Sighting,
}

/// Frames of a robot.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Frames {
    base: String,
    /// Where transforms have odometry.
    odom: Option<String>,
}

impl ScanLocator {
    /// For so many lidars, with what the settings say of them; whether turns by the gyro replace those of odometry.
    pub fn new(settings: &Settings, lidars: usize, gyro_leads: bool) -> Self {
        Self { settings: settings.clone(), lidars, gyro_leads, newest_ns: i64::MIN, ..Self::default() }
    }

    /// As [`ScanLocator::new`], of live sensors: what is recorded at a time is received at it, by the clock, and nothing is
    /// waited for any longer than a moment.
    pub fn live(settings: &Settings, gyro_leads: bool) -> Self {
        let (transforms, odometry) = (TransformBuffer::live(), TransformBuffer::live());
        Self { live: Some(Live::default()), transforms, odometry, ..Self::new(settings, 0, gyro_leads) }
    }

    /// From now on there are so many lidars.
    pub fn set_lidars(&mut self, lidars: usize) {
        (self.lidars, self.waits_until_ns) = (lidars, None);
    }

    /// It is that late, by the time at which things are recorded or received.
    pub fn note_time(&mut self, now_ns: i64) {
        self.newest_ns = self.newest_ns.max(now_ns);
    }

    /// Whether a scan waits for more.
    pub fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Gives up the scan that could not be placed; the lidar that took it.
    pub fn give_up(&mut self) -> Option<u32> {
        self.waits_until_ns = None;
        self.waiting.pop_front().map(|waiting| waiting.lidar)
    }

    /// How often motion was guessed, live.
    pub fn guesses(&self) -> MotionGuesses {
        self.live.as_ref().map(|live| live.guesses).unwrap_or_default()
    }

    /// Takes what a lidar has seen and that was recorded at this time. Scans of one lidar keep their order, those of several are
    /// brought into the order of time.
    pub fn push_sighting(&mut self, recorded_ns: i64, lidar: u32, sighting: Sighting) {
        self.newest_ns = self.newest_ns.max(recorded_ns);
        let is_later =
            |other: &Waiting| other.lidar != lidar && other.sighting.stamp_ns() > sighting.stamp_ns();
        let later = self.waiting.iter().rev().take_while(|other| is_later(other)).count();
        let at = self.waiting.len() - later;
        if let Some(live) = &mut self.live {
            live.order.note(lidar, sighting.stamp_ns(), recorded_ns);
        }
        if at == 0 {
            self.waits_until_ns = None;
        }
        self.waiting.insert(at, Waiting { recorded_ns, lidar, sighting });
    }

    /// Takes odometry.
    pub fn push_odometry(&mut self, recorded_ns: i64, reading: &OdometryReading) {
        self.newest_ns = self.newest_ns.max(recorded_ns);
        let transform = &reading.transform;
        // Some drivers leave the names out.
        let (parent, child) = (frame_name(&transform.parent), frame_name(&transform.child));
        let frames = (
            if parent.is_empty() { "odom" } else { parent },
            if child.is_empty() { "base_link" } else { child },
        );
        let is_new =
            self.odometry_frames.as_ref().is_none_or(|(parent, child)| (&**parent, &**child) != frames);
        if is_new {
            self.odometry_frames = Some((frames.0.to_owned(), frames.1.to_owned()));
        }
        self.note_motion(is_new, Some(reading.twist));
        self.odometry.insert_pose(frames, transform.stamp_ns, &transform.parent_from_child, false);
    }

    /// Takes rates of turning.
    pub fn push_imu(&mut self, recorded_ns: i64, reading: ImuReading) {
        self.newest_ns = self.newest_ns.max(recorded_ns);
        self.note_motion(false, None);
        self.gyro.push(reading);
    }

    /// Takes transforms.
    pub fn push_transforms(&mut self, recorded_ns: i64, transforms: &[StampedTransform], is_static: bool) {
        self.newest_ns = self.newest_ns.max(recorded_ns);
        let mut is_new = false;
        for transform in transforms {
            is_new |= !self.transforms.links(&transform.parent, &transform.child);
            self.transforms.insert(transform, is_static);
        }
        self.note_motion(is_new, None);
    }

    /// A scan may wait for it. Live, a new link between frames may be the one that was missing: they are chosen anew.
    fn note_motion(&mut self, links_anew: bool, twist: Option<Option<Twist>>) {
        let newest_ns = self.newest_ns;
        self.waits_until_ns = None;
        if let Some(live) = &mut self.live {
            live.motion_ns = newest_ns;
            live.twist = twist.unwrap_or(live.twist);
            if links_anew {
                self.frames = None;
                self.last_places.clear();
            }
        }
    }

    /// The next scan, placed; `None` while it waits for more. At the end nothing waits.
    ///
    /// # Errors
    /// When transforms do not say where the lidar sits, or say that it is tilted.
    pub fn take(&mut self, at_end: bool) -> Result<Option<ScanBuffer>, LocateError> {
        let has_come = |until_ns| self.newest_ns >= until_ns || at_end;
        if self.waits_until_ns.is_some_and(|until_ns| !has_come(until_ns)) {
            return Ok(None);
        }
        let Some(mut front) = self.waiting.pop_front() else { return Ok(None) };
        let located = match self.frames.take().or_else(|| self.frames_for(&front, at_end)) {
            Some(frames) => {
                let located = self.locate(&mut front, &frames, at_end);
                self.frames = Some(frames);
                located
            }
            None => Ok(None),
        };
        if !matches!(located, Ok(Some(_))) {
            // It leaves the queue when it is placed, or given up.
            self.waiting.push_front(front);
        }
        located
    }

    /// The frames, once enough transforms have come for the first scan.
    fn frames_for(&self, front: &Waiting, at_end: bool) -> Option<Frames> {
        let waited_ns = self.newest_ns.saturating_sub(front.recorded_ns);
        let frame = front.sighting.frame();
        let first_wait_ns = match &self.live {
            None => FIRST_WAIT_NS,
            Some(_) if front.sighting.mounting().is_some() || frame.is_empty() => 0,
            Some(_) if self.is_placed(front.lidar, frame) => 0,
            Some(_) => LIVE_FIRST_WAIT_NS,
        };
        (waited_ns >= first_wait_ns || at_end).then(|| self.choose_frames(frame))
    }

    /// Places what was seen; `None` while it waits for more.
    fn locate(
        &mut self,
        front: &mut Waiting,
        frames: &Frames,
        at_end: bool,
    ) -> Result<Option<ScanBuffer>, LocateError> {
        let Waiting { recorded_ns, lidar, ref mut sighting } = *front;
        let waited_ns = self.newest_ns.saturating_sub(recorded_ns);
        let stamp_ns = sighting.stamp_ns();
        self.integrate_gyro(frames);
        // The clocks of lidar and odometry may differ.
        let odometry_ns = stamp_ns.saturating_add(self.settings.offset_ns(lidar));
        let odometry = self.odometry_in_space(frames, odometry_ns);
        let heading_rad = self.heading_at(frames, odometry_ns);
        let end = odometry.ok().map(|_| self.motion_end(frames, sighting, odometry_ns));
        let is_open = matches!(end, Some(Err(LookupError::NotYet))) && self.live.is_none();
        let may_come =
            odometry == Err(LookupError::NotYet) || heading_rad == Err(LookupError::NotYet) || is_open;
        let (waits, wait_ns) = match &self.live {
            None => (may_come || self.lidars > 1, WAIT_NS),
            Some(live) => {
                let is_silent = self.newest_ns.saturating_sub(live.motion_ns) > SILENCE_NS;
                let later = live.order.may_come_before(lidar, stamp_ns, self.newest_ns);
                ((may_come && !is_silent) || later, LIVE_WAIT_NS)
            }
        };
        if waits && waited_ns < wait_ns && !at_end {
            self.waits_until_ns = self.live.is_none().then(|| recorded_ns.saturating_add(wait_ns));
            return Ok(None);
        }
        let place = self.sits_at(frames, lidar, sighting)?;
        let known = odometry.ok().map(|pose| planar(&pose));
        let odometry = known.or_else(|| self.last_odometry(frames, odometry_ns));
        self.count_guess(frames, known.is_some(), odometry.is_some());
        let mut scan = match sighting {
            Sighting::Scan(scan) => self.mounted(std::mem::take(&mut scan.scan), lidar, &place),
            Sighting::Cloud(cloud) => slice(cloud, &place.base_from_laser, self.settings.cloud_heights_m),
        };
        scan.header.id.lidar = lidar;
        self.add_odometry(&mut scan, odometry, heading_rad.ok());
        if let (Some(from), Some(Ok(end))) = (known.filter(|pose| pose.is_finite()), end)
            && let Some(motion) = end.motion_from(from).filter(|_| !self.gyro_leads)
        {
            scan.add_motion(motion);
        }
        self.waits_until_ns = None;
        Ok(Some(scan))
    }

    fn count_guess(&mut self, frames: &Frames, is_known: bool, is_near: bool) {
        let gets_motion = self.odometry_frames.is_some() || frames.odom.is_some();
        let Some(live) = self.live.as_mut().filter(|_| gets_motion && !is_known) else { return };
        let guesses = &mut live.guesses;
        *(if is_near { &mut guesses.extrapolated } else { &mut guesses.without }) += 1;
    }
}

#[cfg(test)]
mod tests;
