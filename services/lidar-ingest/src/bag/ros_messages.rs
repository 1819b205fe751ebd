//! Decodes serialized `sensor_msgs/LaserScan` and `nav_msgs/Odometry` messages: bytes in, a scan or a pose out.

use crate::settings::{BEAMS_MAX, RANGE_MIN_M};
use flockslam_geometry::Pose;
use flockslam_messages::{ScanBuffer, ScanSections};

/// Why a message does not match its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageProblem {
    /// It ends too early, or says that it holds more than it does.
    #[error("the message breaks off")]
    BreaksOff,
    /// More beams than are taken.
    #[error("the scan claims to have more than 10 million beams")]
    TooManyBeams,
    /// An angle or a pose is not finite.
    #[error("an angle, a limit or a pose is not finite")]
    NotFinite,
}

/// A pose of odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryMessage {
    /// When, nanoseconds.
    pub stamp_ns: i64,
    /// Where: `odom_from_base`.
    pub pose: Pose,
}

/// Numbers of a serialized message, one after the other (little endian, without gaps).
struct Numbers<'a>(&'a [u8]);

impl<'a> Numbers<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], MessageProblem> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(MessageProblem::BreaksOff)?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], MessageProblem> {
        Ok(self.bytes(N)?.try_into().expect("so many were taken"))
    }

    fn u32(&mut self) -> Result<u32, MessageProblem> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn f32(&mut self) -> Result<f32, MessageProblem> {
        Ok(f32::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64, MessageProblem> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    fn text(&mut self) -> Result<(), MessageProblem> {
        let length = self.u32()? as usize;
        self.bytes(length).map(drop)
    }

    /// A `std_msgs/Header`: its stamp, nanoseconds.
    fn header(&mut self) -> Result<i64, MessageProblem> {
        self.u32()?;
        let (seconds, nanoseconds) = (i64::from(self.u32()?), i64::from(self.u32()?));
        self.text()?;
        Ok(seconds * 1_000_000_000 + nanoseconds)
    }

    /// The bytes of a `float32[]` and how many numbers it has.
    fn floats(&mut self) -> Result<&'a [u8], MessageProblem> {
        let count = self.u32()? as usize;
        self.bytes(count.checked_mul(4).ok_or(MessageProblem::BreaksOff)?)
    }
}

/// Reads a serialized `sensor_msgs/LaserScan` into `scan`, whose memory is used again: stamp, angles, times of beams, limits, ranges
/// and intensities. The rest of its header is as new.
///
/// # Errors
/// When the bytes are not such a message, or it has more beams than are taken.
pub fn laser_scan(bytes: &[u8], scan: &mut ScanBuffer) -> Result<(), MessageProblem> {
    let mut numbers = Numbers(bytes);
    let stamp_ns = numbers.header()?;
    let [angle_min, _angle_max, increment, time_increment, _scan_time, range_min, range_max] =
        [0; 7].map(|_: u8| numbers.f32()).map(|number| number.unwrap_or(f32::NAN));
    let ranges = numbers.floats()?;
    let beams = ranges.len() / 4;
    if beams as u64 > u64::from(BEAMS_MAX) {
        return Err(MessageProblem::TooManyBeams);
    }
    let intensities = numbers.floats()?;
    let shape = [angle_min, increment, range_min, range_max];
    if !shape.into_iter().all(f32::is_finite) {
        return Err(MessageProblem::NotFinite);
    }
    *scan = ScanBuffer { numbers: std::mem::take(&mut scan.numbers), ..ScanBuffer::default() };
    let header = &mut scan.header;
    header.times.sensor_ns = stamp_ns;
    (header.angle_min_rad, header.angle_increment_rad) = (f64::from(angle_min), f64::from(increment));
    header.range_min_m = range_min.max(RANGE_MIN_M);
    header.range_max_m = range_max;
    header.time_increment_s = if time_increment.is_finite() { time_increment } else { 0.0 };
    header.beam_count = beams as u32;
    scan.numbers.clear();
    let decoded = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().expect("four of them"));
    scan.numbers.extend(ranges.chunks_exact(4).map(decoded));
    if beams > 0 && intensities.len() == ranges.len() {
        header.sections = ScanSections::INTENSITIES;
        scan.numbers.extend(intensities.chunks_exact(4).map(decoded));
    }
    Ok(())
}

/// Reads a serialized `nav_msgs/Odometry`: the pose in the plane.
///
/// # Errors
/// When the bytes are not such a message.
pub fn odometry(bytes: &[u8]) -> Result<OdometryMessage, MessageProblem> {
    let mut numbers = Numbers(bytes);
    let stamp_ns = numbers.header()?;
    numbers.text()?;
    let mut next = || numbers.f64();
    let (x_m, y_m, _z_m) = (next()?, next()?, next()?);
    let (x, y, z, w) = (next()?, next()?, next()?, next()?);
    let heading_rad = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    let pose = Pose::new(x_m, y_m, heading_rad);
    if pose.is_finite() { Ok(OdometryMessage { stamp_ns, pose }) } else { Err(MessageProblem::NotFinite) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn header() -> Vec<u8> {
        [&7u32.to_le_bytes()[..], &12u32.to_le_bytes(), &500u32.to_le_bytes(), &5u32.to_le_bytes(), b"laser"]
            .concat()
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    fn message() -> Vec<u8> {
        let shape = floats(&[-1.5, 1.5, 0.5, 1e-3, 0.1, 0.02, 30.0]);
        let ranges = [&4u32.to_le_bytes()[..], &floats(&[1.0, f32::INFINITY, f32::NAN, 2.5])].concat();
        [header(), shape, ranges, 0u32.to_le_bytes().to_vec()].concat()
    }

    #[test]
    fn a_laser_scan_becomes_a_scan() {
        let mut scan = ScanBuffer::from_ranges(&[9.0; 9], 0.0, 1.0);
        laser_scan(&message(), &mut scan).unwrap();
        let view = scan.view().unwrap();
        assert_eq!((view.len(), scan.header.times.sensor_ns), (4, 12_000_000_500));
        assert_eq!([0, 1, 2, 3].map(|beam| view.valid_range_m(beam)), [Some(1.0), None, None, Some(2.5)]);
        assert_eq!((view.angle_rad(3), scan.header.range_max_m), (0.0, 30.0));
        let shape = floats(&[-1.5, 1.5, 0.5, 1e-3, 0.1, 0.02, 30.0]);
        let ranges = [&(BEAMS_MAX + 1).to_le_bytes()[..], &vec![0; 4 * (BEAMS_MAX as usize + 1)]].concat();
        let huge = [header(), shape, ranges].concat();
        assert_eq!(laser_scan(&huge, &mut scan), Err(MessageProblem::TooManyBeams));
        for cut in 0..message().len() {
            assert!(laser_scan(&message()[..cut], &mut scan).is_err(), "{cut}");
        }
    }

    #[test]
    fn odometry_is_a_pose_in_the_plane() {
        let numbers = [1.0f64, -2.0, 0.3, 0.0, 0.0, (0.25f64).sin(), (0.25f64).cos()];
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let text = [&4u32.to_le_bytes()[..], b"base"].concat();
        let found = odometry(&[header(), text, bytes].concat()).unwrap();
        assert_eq!(found.stamp_ns, 12_000_000_500);
        assert!(found.pose.distance_m(Pose::new(1.0, -2.0, 0.0)) < 1e-12);
        assert!((found.pose.heading_rad - 0.5).abs() < 1e-12);
        assert!(odometry(&header()).is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(at in 0usize..80, value in any::<u8>(), more in prop::collection::vec(any::<u8>(), 0..40)) {
            let mut bytes = message();
            bytes.extend(more);
            let place = at % bytes.len();
            bytes[place] = value;
            let mut scan = ScanBuffer::default();
            if laser_scan(&bytes, &mut scan).is_ok() {
                prop_assert!(scan.view().is_ok());
            }
            let _ = odometry(&bytes);
        }
    }
}
