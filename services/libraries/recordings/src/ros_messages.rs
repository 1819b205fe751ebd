//! What messages of ROS say: a scan, odometry, transforms, rates of turning. Clouds of points have a file of their own.

use crate::cloud_message::{FramedCloud, point_cloud};
use crate::message_fields::{Fields, MessageProblem, Wire};
use crate::set_record::{SET_RECORD_TYPE, SetRecord};
use flockslam_messages::{Message, ScanBuffer, ScanHeader, ScanSections};
use flockslam_sensor_stream::{BEAMS_MAX, FramedScan, ImuReading, OdometryReading, is_plausible_sweep};
use flockslam_transforms::{Isometry3, StampedTransform, pose_in_space};
use nalgebra::Vector3;

/// Ranges below are not returns, metres: nothing is nearer to a lidar than its own housing, and sensors write 0 for "no return".
const RANGE_MIN_M: f32 = 0.05;

/// Into so many parts a degree is divided by the steps of lidars: 1°, 0.5°, ⅓°, 0.25° …; the last has the fractions of a turn by 1024.
const FRACTIONS_OF_DEGREES: [f64; 8] = [1.0, 2.0, 3.0, 4.0, 10.0, 16.0, 100.0, 128.0];

/// Kinds of messages that are understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ReadingKind {
    /// `sensor_msgs/LaserScan`.
    Scan,
    /// `sensor_msgs/MultiEchoLaserScan`.
    MultiEchoScan,
    /// `sensor_msgs/PointCloud2`.
    Cloud,
    /// `nav_msgs/Odometry`.
    Odometry,
    /// `sensor_msgs/Imu`.
    Imu,
    /// `tf2_msgs/TFMessage`, `tf/tfMessage`.
    Transforms,
    /// A scan as it was on the bus of a set.
    BusScan,
    /// What else was on it.
    SetRecord,
}

/// Content of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Reading {
    /// A scan.
    Scan(FramedScan),
    /// Points in space.
    Cloud(FramedCloud),
    /// The pose by odometry.
    Odometry(OdometryReading),
    /// How fast the robot turns.
    Imu(ImuReading),
    /// Poses of frames.
    Transforms(Vec<StampedTransform>),
    /// A scan as it was on the bus of a set, with everything that belongs to it.
    BusScan(ScanBuffer),
    /// What else was on it.
    SetRecord(SetRecord),
}

impl ReadingKind {
    /// The kind by the name of a message's type, with or without `msg/` in it.
    pub fn of_type(name: &str) -> Option<Self> {
        match name.replace("/msg/", "/").as_str() {
            "sensor_msgs/LaserScan" => Some(Self::Scan),
            "sensor_msgs/MultiEchoLaserScan" => Some(Self::MultiEchoScan),
            "sensor_msgs/PointCloud2" => Some(Self::Cloud),
            "nav_msgs/Odometry" => Some(Self::Odometry),
            "sensor_msgs/Imu" => Some(Self::Imu),
            "tf2_msgs/TFMessage" | "tf/tfMessage" => Some(Self::Transforms),
            ScanHeader::TYPE_NAME => Some(Self::BusScan),
            SET_RECORD_TYPE => Some(Self::SetRecord),
            _ => None,
        }
    }

    /// Whether it is a scan of a planar lidar.
    pub fn is_scan(self) -> bool {
        matches!(self, Self::Scan | Self::MultiEchoScan)
    }
}

impl Reading {
    /// Reads a serialized message.
    ///
    /// # Errors
    /// When the bytes are not such a message, or it has more beams than are taken.
    pub fn decode(kind: ReadingKind, bytes: &[u8], wire: Wire) -> Result<Self, MessageProblem> {
        Self::decode_with(kind, bytes, wire, &mut Spares::default())
    }

    /// As [`Reading::decode`], with memory of messages before.
    pub(crate) fn decode_with(
        kind: ReadingKind,
        bytes: &[u8],
        wire: Wire,
        spares: &mut Spares,
    ) -> Result<Self, MessageProblem> {
        if matches!(kind, ReadingKind::BusScan | ReadingKind::SetRecord) != (wire == Wire::Bus) {
            return Err(MessageProblem::UnknownEncoding);
        }
        let fields = Fields::new(bytes, wire)?;
        match kind {
            ReadingKind::BusScan => {
                ScanBuffer::from_bytes(bytes).map(Self::BusScan).ok_or(MessageProblem::BreaksOff)
            }
            ReadingKind::SetRecord => {
                SetRecord::from_bytes(bytes).map(Self::SetRecord).ok_or(MessageProblem::BreaksOff)
            }
            ReadingKind::Scan | ReadingKind::MultiEchoScan => {
                laser_scan(fields, kind, spares).map(Self::Scan)
            }
            ReadingKind::Cloud => point_cloud(fields).map(Self::Cloud),
            ReadingKind::Odometry => odometry(fields).map(Self::Odometry),
            ReadingKind::Imu => imu(fields).map(Self::Imu),
            ReadingKind::Transforms => transforms(fields).map(Self::Transforms),
        }
    }
}

/// Memory that is used again for the next message.
#[derive(Debug, Default)]
pub(crate) struct Spares {
    /// Of a scan.
    pub numbers: Vec<f32>,
}

fn laser_scan(
    mut fields: Fields<'_>,
    kind: ReadingKind,
    spares: &mut Spares,
) -> Result<FramedScan, MessageProblem> {
    let (stamp_ns, frame) = fields.header()?;
    let [angle_min, _angle_max, increment, time_increment, _scan_time, range_min, range_max] =
        fields.f32s()?;
    let mut numbers = std::mem::take(&mut spares.numbers);
    numbers.clear();
    let beams = match kind {
        ReadingKind::MultiEchoScan => last_echoes(&mut fields, &mut numbers)?,
        _ => fields.floats(&mut numbers)?,
    };
    if beams > BEAMS_MAX {
        return Err(MessageProblem::TooManyBeams);
    }
    match kind {
        ReadingKind::MultiEchoScan => last_echoes(&mut fields, &mut numbers)?,
        _ => fields.floats(&mut numbers)?,
    };
    let message = LaserScanMessage {
        stamp_ns,
        frame,
        angle_min_rad: angle_min,
        angle_increment_rad: increment,
        time_increment_s: time_increment,
        range_min_m: range_min,
        range_max_m: range_max,
        beams,
        numbers,
    };
    message.into_scan()
}

/// Content of a `sensor_msgs/LaserScan`, unchanged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LaserScanMessage {
    /// When the first beam was measured, nanoseconds.
    pub stamp_ns: i64,
    /// The lidar's frame.
    pub frame: String,
    /// Of the first beam, radians.
    pub angle_min_rad: f32,
    /// From beam to beam, radians.
    pub angle_increment_rad: f32,
    /// From beam to beam, seconds.
    pub time_increment_s: f32,
    /// Nothing is measured below, metres.
    pub range_min_m: f32,
    /// Nothing is measured beyond, metres.
    pub range_max_m: f32,
    /// Number of ranges.
    pub beams: usize,
    /// The ranges, metres, and behind them the intensities.
    pub numbers: Vec<f32>,
}

impl LaserScanMessage {
    /// The scan that it is: angles exact, limits and times of beams plausible, intensities where each beam has one.
    ///
    /// # Errors
    /// When it has more beams than are taken, or limits that are no numbers.
    pub fn into_scan(self) -> Result<FramedScan, MessageProblem> {
        if self.beams > BEAMS_MAX {
            return Err(MessageProblem::TooManyBeams);
        }
        let (beams, mut numbers) = (self.beams, self.numbers);
        let has_intensities = beams > 0 && numbers.len() == 2 * beams;
        if !has_intensities {
            numbers.truncate(beams);
        }
        // A lidar without a limit of its range says so with an infinity.
        let limits = [self.angle_min_rad, self.angle_increment_rad, self.range_min_m];
        if !limits.into_iter().all(f32::is_finite) || self.range_max_m.is_nan() {
            return Err(MessageProblem::NotFinite);
        }
        let mut scan = ScanBuffer { numbers, ..ScanBuffer::default() };
        let header = &mut scan.header;
        header.times.sensor_ns = self.stamp_ns;
        header.angle_min_rad = exact_rad(self.angle_min_rad);
        header.angle_increment_rad = exact_rad(self.angle_increment_rad);
        header.range_min_m = self.range_min_m.max(RANGE_MIN_M);
        // Many drivers write the limit itself where nothing has returned.
        header.range_max_m = self.range_max_m.min(f32::MAX).next_down();
        let is_plausible = is_plausible_sweep(self.time_increment_s, beams);
        header.time_increment_s = if is_plausible { self.time_increment_s } else { 0.0 };
        header.beam_count = beams as u32;
        header.sections = if has_intensities { ScanSections::INTENSITIES } else { 0 };
        Ok(FramedScan { frame: self.frame, scan, mounting: None })
    }
}

/// An angle of which a message has the nearest number of 32 bits: lidars have steps and limits of whole degrees, or of simple fractions
/// of them, and the last of a thousand beams is as exact as the first.
fn exact_rad(rounded_rad: f32) -> f64 {
    let degrees = f64::from(rounded_rad).to_degrees();
    let candidates =
        FRACTIONS_OF_DEGREES.iter().map(|parts| ((degrees * parts).round() / parts).to_radians());
    candidates.into_iter().find(|exact| *exact as f32 == rounded_rad).unwrap_or(f64::from(rounded_rad))
}

/// Of each beam of a `LaserEcho[]` the last echo: what is behind glass and rain. NaN where a beam has none.
fn last_echoes(fields: &mut Fields<'_>, numbers: &mut Vec<f32>) -> Result<usize, MessageProblem> {
    let beams = fields.u32()? as usize;
    for beam in 0..beams {
        if beam == BEAMS_MAX {
            return Err(MessageProblem::TooManyBeams);
        }
        let echoes = fields.u32()? as usize;
        let last = match echoes.checked_sub(1) {
            Some(before) => {
                fields.skip_floats(before)?;
                fields.f32()?
            }
            None => f32::NAN,
        };
        numbers.push(last);
    }
    Ok(beams)
}

fn odometry(mut fields: Fields<'_>) -> Result<OdometryReading, MessageProblem> {
    let (stamp_ns, parent) = fields.header()?;
    let child = fields.text()?;
    let parent_from_child = pose(&mut fields)?;
    Ok(OdometryReading {
        transform: StampedTransform { stamp_ns, parent, child, parent_from_child },
        twist: None,
    })
}

fn imu(mut fields: Fields<'_>) -> Result<ImuReading, MessageProblem> {
    let (stamp_ns, frame) = fields.header()?;
    // A quaternion and its covariance.
    fields.f64s::<{ 4 + 9 }>()?;
    let turn_rad_s = Vector3::from(fields.f64s::<3>()?);
    if !turn_rad_s.iter().all(|rate| rate.is_finite()) {
        return Err(MessageProblem::NotFinite);
    }
    Ok(ImuReading { stamp_ns, frame, turn_rad_s })
}

fn transforms(mut fields: Fields<'_>) -> Result<Vec<StampedTransform>, MessageProblem> {
    let count = fields.u32()?;
    let mut found = Vec::new();
    for _ in 0..count {
        let (stamp_ns, parent) = fields.header()?;
        let child = fields.text()?;
        let parent_from_child = pose(&mut fields)?;
        found.push(StampedTransform { stamp_ns, parent, child, parent_from_child });
    }
    Ok(found)
}

/// A position and a quaternion.
fn pose(fields: &mut Fields<'_>) -> Result<Isometry3<f64>, MessageProblem> {
    let [x, y, z, rotation @ ..] = fields.f64s::<7>()?;
    pose_in_space([x, y, z], rotation).ok_or(MessageProblem::NotFinite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
    }

    fn header(frame: &str) -> Vec<u8> {
        [&7u32.to_le_bytes()[..], &12u32.to_le_bytes(), &500u32.to_le_bytes(), &text(frame)].concat()
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    fn array(values: &[f32]) -> Vec<u8> {
        [&(values.len() as u32).to_le_bytes()[..], &floats(values)].concat()
    }

    fn doubles(values: &[f64]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    const SHAPE: [f32; 7] = [-1.5, 1.5, 0.5, 1e-3, 0.1, 0.02, 30.0];

    fn message(time_increment_s: f32) -> Vec<u8> {
        let mut shape = SHAPE;
        shape[3] = time_increment_s;
        let ranges = array(&[1.0, f32::INFINITY, f32::NAN, 2.5]);
        [header("laser"), floats(&shape), ranges, array(&[])].concat()
    }

    fn scan(bytes: &[u8], kind: ReadingKind) -> Result<FramedScan, MessageProblem> {
        Reading::decode(kind, bytes, Wire::Ros1).map(|reading| match reading {
            Reading::Scan(scan) => scan,
            other => panic!("{other:?}"),
        })
    }

    #[test]
    fn a_laser_scan_becomes_a_scan() {
        let found = scan(&message(1e-3), ReadingKind::Scan).unwrap();
        let view = found.scan.view().unwrap();
        assert_eq!((found.frame.as_str(), view.len()), ("laser", 4));
        assert_eq!(found.scan.header.times.sensor_ns, 12_000_000_500);
        assert_eq!([0, 1, 2, 3].map(|beam| view.valid_range_m(beam)), [Some(1.0), None, None, Some(2.5)]);
        assert_eq!(view.angle_rad(3), 0.0);
        assert_eq!(found.scan.header.time_increment_s, 1e-3);
        for cut in 0..message(0.0).len() {
            assert!(scan(&message(0.0)[..cut], ReadingKind::Scan).is_err(), "{cut}");
        }
    }

    #[test]
    fn nothing_of_the_scan_before_is_left_in_its_memory() {
        let mut spares = Spares { numbers: vec![9.0; 100] };
        let found = Reading::decode_with(ReadingKind::Scan, &message(0.0), Wire::Ros1, &mut spares);
        let Ok(Reading::Scan(found)) = found else { panic!("not a scan") };
        assert_eq!((found.scan.numbers.len(), found.scan.numbers[3]), (4, 2.5));
        assert!(found.scan.numbers.capacity() >= 100 && spares.numbers.is_empty());
    }

    #[test]
    fn the_limit_itself_is_no_return() {
        let ranges = array(&[30.0, 29.99]);
        let bytes = [header("laser"), floats(&SHAPE), ranges, array(&[])].concat();
        let found = scan(&bytes, ReadingKind::Scan).unwrap().scan;
        let view = found.view().unwrap();
        assert!(view.valid_range_m(0).is_none() && view.valid_range_m(1).is_some());
    }

    #[test]
    fn angles_of_whole_degrees_and_simple_fractions_are_exact() {
        for exact in [-FRAC_PI_2, PI / 180.0, PI / 360.0, PI / 720.0, PI / 512.0, 0.0] {
            assert!((exact_rad(exact as f32) - exact).abs() < 1e-16, "{exact}");
        }
        assert_eq!(exact_rad(0.007_016_24), f64::from(0.007_016_24_f32));
    }

    #[test]
    fn times_of_beams_that_no_lidar_has_are_left_out() {
        for senseless in [153_333.0, f32::NAN, -1.0] {
            let found = scan(&message(senseless), ReadingKind::Scan).unwrap();
            assert_eq!(found.scan.header.time_increment_s, 0.0, "{senseless}");
        }
    }

    #[test]
    fn of_several_echoes_the_last_counts() {
        let echoes = [&3u32.to_le_bytes()[..], &array(&[1.0, 4.0]), &array(&[]), &array(&[2.0])].concat();
        let bytes = [header("laser"), floats(&SHAPE), echoes, 0u32.to_le_bytes().to_vec()].concat();
        let found = scan(&bytes, ReadingKind::MultiEchoScan).unwrap();
        let view = found.scan.view().unwrap();
        assert_eq!([0, 1, 2].map(|beam| view.valid_range_m(beam)), [Some(4.0), None, Some(2.0)]);
    }

    #[test]
    fn odometry_and_transforms_are_poses_between_frames() {
        let pose = doubles(&[1.0, -2.0, 0.3, 0.0, 0.0, (0.25f64).sin(), (0.25f64).cos()]);
        let one = [header("odom"), text("base_link"), pose].concat();
        let Reading::Odometry(found) = Reading::decode(ReadingKind::Odometry, &one, Wire::Ros1).unwrap()
        else {
            panic!("not odometry")
        };
        let transform = found.transform;
        assert_eq!((transform.parent.as_str(), transform.child.as_str()), ("odom", "base_link"));
        assert!((transform.parent_from_child.rotation.euler_angles().2 - 0.5).abs() < 1e-12);
        let two = [&2u32.to_le_bytes()[..], &one, &one].concat();
        let found = Reading::decode(ReadingKind::Transforms, &two, Wire::Ros1).unwrap();
        assert_eq!(found, Reading::Transforms(vec![transform.clone(), transform]));
        let nowhere = [header("odom"), text("base_link"), doubles(&[0.0; 7])].concat();
        let found = Reading::decode(ReadingKind::Odometry, &nowhere, Wire::Ros1);
        assert_eq!(found, Err(MessageProblem::NotFinite));
    }

    #[test]
    fn an_imu_gives_the_angular_velocity() {
        let rates = doubles(&[0.1, -0.2, 0.3]);
        let bytes = [header("imu"), doubles(&[0.0; 13]), rates, doubles(&[0.0; 21])].concat();
        let Ok(Reading::Imu(found)) = Reading::decode(ReadingKind::Imu, &bytes, Wire::Ros1) else {
            panic!("not an IMU")
        };
        assert_eq!((found.frame.as_str(), found.turn_rad_s), ("imu", Vector3::new(0.1, -0.2, 0.3)));
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(
            at in 0usize..80, value in any::<u8>(), more in prop::collection::vec(any::<u8>(), 0..40), cdr in any::<bool>()
        ) {
            let mut bytes = message(0.0);
            if cdr {
                bytes.splice(0..4, [0, 1, 0, 0]);
            }
            bytes.extend(more);
            let place = at % bytes.len();
            bytes[place] = value;
            let wire = if cdr { Wire::Cdr } else { Wire::Ros1 };
            use ReadingKind::{Cloud, Imu, MultiEchoScan, Odometry, Scan, Transforms};
            for kind in [Scan, MultiEchoScan, Cloud, Odometry, Imu, Transforms] {
                if let Ok(Reading::Scan(found)) = Reading::decode(kind, &bytes, wire) {
                    prop_assert!(found.scan.view().is_ok());
                }
            }
        }
    }
}
