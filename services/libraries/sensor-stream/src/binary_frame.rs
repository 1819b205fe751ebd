//! Binary frames: a header of 16 bytes, then the fields, little endian.

use crate::readings::{
    BEAMS_MAX, FramedScan, ImuReading, LidarScan, OdometryReading, SensorFrame, TransformsReading,
    is_plausible_sweep,
};
use crate::{FrameProblem, frame_reader::FRAME_BYTES_MAX};
use flockslam_geometry::{Pose, Twist};
use flockslam_messages::{ScanBuffer, ScanSections};
use flockslam_transforms::{Isometry3, Mounting, StampedTransform, pose_in_space};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

/// How a frame begins: a byte that no text has, two letters, the version.
pub(crate) const MAGIC: [u8; 4] = [0xfa, b'S', b'S', 1];
/// Magic, kind, a reserved word, length of the fields, their CRC-32.
pub(crate) const HEADER_BYTES: usize = 16;

const SCAN: u16 = 1;
const ODOMETRY: u16 = 2;
const TRANSFORMS: u16 = 3;
const IMU: u16 = 4;

/// Flags of a scan, above those of its sections.
const HAS_MOUNTING: u32 = 8;
const UPSIDE_DOWN: u32 = 16;
/// Flag of odometry.
const HAS_TWIST: u32 = 1;
/// Flag of transforms.
const STATIC: u32 = 1;

/// Kind, length of the fields, checksum of them: what a header says.
#[derive(Clone, Copy)]
pub(crate) struct FrameHeader {
    pub kind: u16,
    pub length: usize,
    pub checksum: u32,
}

impl FrameHeader {
    /// From the bytes that follow the magic.
    pub fn read(bytes: &[u8; HEADER_BYTES]) -> Self {
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let kind = u16::from_le_bytes([bytes[4], bytes[5]]);
        Self { kind, length: word(8) as usize, checksum: word(12) }
    }
}

impl SensorFrame {
    /// Appends the frame as bytes. Names beyond 255 bytes are cut, as are scans and lists beyond what a frame takes.
    pub fn write_binary(&self, to: &mut Vec<u8>) {
        let begin = to.len();
        to.extend(MAGIC);
        let kind = match self {
            Self::Scan(_) => SCAN,
            Self::Odometry(_) => ODOMETRY,
            Self::Transforms(_) => TRANSFORMS,
            Self::Imu(_) => IMU,
        };
        to.extend(kind.to_le_bytes());
        to.extend([0; 10]);
        match self {
            Self::Scan(scan) => write_scan(to, scan),
            Self::Odometry(reading) => write_odometry(to, reading),
            Self::Transforms(reading) => write_transforms(to, reading),
            Self::Imu(reading) => {
                to.extend(reading.stamp_ns.to_le_bytes());
                write_doubles(to, reading.turn_rad_s.iter().copied());
                write_name(to, &reading.frame);
            }
        }
        let fields = begin + HEADER_BYTES;
        let (length, checksum) = ((to.len() - fields) as u32, crc32fast::hash(&to[fields..]));
        to[begin + 8..begin + 12].copy_from_slice(&length.to_le_bytes());
        to[begin + 12..fields].copy_from_slice(&checksum.to_le_bytes());
    }
}

fn write_doubles(to: &mut Vec<u8>, values: impl IntoIterator<Item = f64>) {
    values.into_iter().for_each(|value| to.extend(value.to_le_bytes()));
}

fn write_name(to: &mut Vec<u8>, name: &str) {
    let mut end = name.len().min(usize::from(u8::MAX));
    while !name.is_char_boundary(end) {
        end -= 1;
    }
    to.push(end as u8);
    to.extend(&name.as_bytes()[..end]);
}

fn write_scan(to: &mut Vec<u8>, reading: &LidarScan) {
    let FramedScan { frame, scan, mounting } = &reading.scan;
    let header = &scan.header;
    let mut flags = header.sections & ScanSections::ALL;
    if let Some(mounting) = mounting {
        flags |= HAS_MOUNTING | if mounting.upside_down { UPSIDE_DOWN } else { 0 };
    }
    to.extend(header.times.sensor_ns.to_le_bytes());
    to.extend(header.beam_count.to_le_bytes());
    to.extend(flags.to_le_bytes());
    write_doubles(to, [header.angle_min_rad, header.angle_increment_rad]);
    for value in [header.time_increment_s, header.range_min_m, header.range_max_m] {
        to.extend(value.to_le_bytes());
    }
    if let Some(Mounting { base_from_laser, .. }) = mounting {
        write_doubles(to, [base_from_laser.x_m, base_from_laser.y_m, base_from_laser.heading_rad]);
    }
    write_name(to, &reading.lidar);
    write_name(to, frame);
    scan.numbers.iter().for_each(|number| to.extend(number.to_le_bytes()));
}

fn write_odometry(to: &mut Vec<u8>, reading: &OdometryReading) {
    let pose = flockslam_transforms::planar(&reading.transform.parent_from_child);
    let flags = if reading.twist.is_some() { HAS_TWIST } else { 0 };
    to.extend(reading.transform.stamp_ns.to_le_bytes());
    to.extend(flags.to_le_bytes());
    write_doubles(to, [pose.x_m, pose.y_m, pose.heading_rad]);
    if let Some(twist) = reading.twist {
        write_doubles(to, [twist.x_m_s, twist.y_m_s, twist.turn_rad_s]);
    }
    write_name(to, &reading.transform.parent);
    write_name(to, &reading.transform.child);
}

fn write_transforms(to: &mut Vec<u8>, reading: &TransformsReading) {
    to.extend(if reading.is_static { STATIC } else { 0 }.to_le_bytes());
    to.extend((reading.transforms.len() as u32).to_le_bytes());
    for transform in &reading.transforms {
        let pose = &transform.parent_from_child;
        to.extend(transform.stamp_ns.to_le_bytes());
        write_doubles(to, pose.translation.vector.iter().chain(pose.rotation.coords.iter()).copied());
        write_name(to, &transform.parent);
        write_name(to, &transform.child);
    }
}

/// The frame of this kind with these fields.
pub(crate) fn read_binary(kind: u16, bytes: &[u8]) -> Result<SensorFrame, FrameProblem> {
    let mut fields = Fields(bytes);
    let frame = match kind {
        SCAN => SensorFrame::Scan(read_scan(&mut fields)?),
        ODOMETRY => SensorFrame::Odometry(read_odometry(&mut fields)?),
        TRANSFORMS => SensorFrame::Transforms(read_transforms(&mut fields)?),
        IMU => {
            let stamp_ns = fields.i64()?;
            let turn_rad_s = Vector3::from(fields.finite()?);
            SensorFrame::Imu(ImuReading { stamp_ns, turn_rad_s, frame: fields.name()? })
        }
        other => return Err(FrameProblem::UnknownKind(other)),
    };
    if fields.0.is_empty() { Ok(frame) } else { Err(FrameProblem::WrongLength) }
}

/// What is left of the fields of a frame.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], FrameProblem> {
        let (bytes, rest) = self.0.split_first_chunk().ok_or(FrameProblem::WrongLength)?;
        self.0 = rest;
        Ok(*bytes)
    }

    fn i64(&mut self) -> Result<i64, FrameProblem> {
        self.bytes().map(i64::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, FrameProblem> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn f32(&mut self) -> Result<f32, FrameProblem> {
        self.bytes().map(f32::from_le_bytes)
    }

    fn finite<const N: usize>(&mut self) -> Result<[f64; N], FrameProblem> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.bytes()?);
        }
        if values.iter().all(|value| value.is_finite()) { Ok(values) } else { Err(FrameProblem::NotFinite) }
    }

    fn name(&mut self) -> Result<String, FrameProblem> {
        let [length] = self.bytes()?;
        let (name, rest) = self.0.split_at_checked(usize::from(length)).ok_or(FrameProblem::WrongLength)?;
        self.0 = rest;
        let name = String::from_utf8(name.to_vec()).map_err(|_| FrameProblem::BadName)?;
        checked_name(name)
    }
}

/// A name that fits in a frame and in a line.
pub(crate) fn checked_name(name: String) -> Result<String, FrameProblem> {
    let is_sound = name.len() <= usize::from(u8::MAX) && !name.contains(char::is_control);
    if is_sound { Ok(name) } else { Err(FrameProblem::BadName) }
}

fn read_scan(fields: &mut Fields<'_>) -> Result<LidarScan, FrameProblem> {
    let (stamp_ns, beams, flags) = (fields.i64()?, fields.u32()?, fields.u32()?);
    let [angle_min_rad, angle_increment_rad] = fields.finite()?;
    let (time_increment_s, range_min_m, range_max_m) = (fields.f32()?, fields.f32()?, fields.f32()?);
    let mounting = if flags & HAS_MOUNTING == 0 { None } else { Some(read_mounting(fields, flags)?) };
    let (lidar, frame) = (fields.name()?, fields.name()?);
    let sections = flags & ScanSections::ALL;
    let lists = 1 + sections.count_ones() as usize;
    if beams == 0 || beams as usize > BEAMS_MAX {
        return Err(FrameProblem::BeamCount);
    }
    if flags & !(ScanSections::ALL | HAS_MOUNTING | UPSIDE_DOWN) != 0
        || fields.0.len() != 4 * lists * beams as usize
    {
        return Err(FrameProblem::WrongLength);
    }
    let numbers = std::mem::take(&mut fields.0).as_chunks::<4>().0;
    let numbers = numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let mut scan = ScanBuffer { numbers, ..ScanBuffer::default() };
    let header = &mut scan.header;
    header.times.sensor_ns = stamp_ns;
    (header.beam_count, header.sections) = (beams, sections);
    (header.angle_min_rad, header.angle_increment_rad) = (angle_min_rad, angle_increment_rad);
    header.time_increment_s = time_increment_s;
    (header.range_min_m, header.range_max_m) = (range_min_m, range_max_m);
    let scan = FramedScan { frame, scan: sound(scan)?, mounting };
    Ok(LidarScan { lidar, scan })
}

/// A scan of which all that is matched by is a number, with times that a lidar may have.
pub(crate) fn sound(mut scan: ScanBuffer) -> Result<ScanBuffer, FrameProblem> {
    let header = &mut scan.header;
    if ![header.range_min_m, header.range_max_m].into_iter().all(f32::is_finite) {
        return Err(FrameProblem::NotFinite);
    }
    let beams = header.beam_count as usize;
    if !is_plausible_sweep(header.time_increment_s, beams) {
        header.time_increment_s = 0.0;
    }
    let view = scan.view().map_err(|_| FrameProblem::NotFinite)?;
    let is_finite = |beam: usize| view.angle_rad(beam).is_finite() && view.time_s(beam).is_finite();
    if header_has_lists(&scan) && !(0..beams).all(is_finite) {
        return Err(FrameProblem::NotFinite);
    }
    Ok(scan)
}

fn header_has_lists(scan: &ScanBuffer) -> bool {
    scan.header.sections & (ScanSections::ANGLES | ScanSections::TIMES) != 0
}

fn read_mounting(fields: &mut Fields<'_>, flags: u32) -> Result<Mounting, FrameProblem> {
    let [x_m, y_m, heading_rad] = fields.finite()?;
    let base_from_laser = Pose::new(x_m, y_m, heading_rad);
    Ok(Mounting { base_from_laser, upside_down: flags & UPSIDE_DOWN != 0 })
}

fn read_odometry(fields: &mut Fields<'_>) -> Result<OdometryReading, FrameProblem> {
    let (stamp_ns, flags) = (fields.i64()?, fields.u32()?);
    let [x_m, y_m, heading_rad] = fields.finite()?;
    let twist = if flags & HAS_TWIST == 0 {
        None
    } else {
        let [x_m_s, y_m_s, turn_rad_s] = fields.finite()?;
        Some(Twist { x_m_s, y_m_s, turn_rad_s })
    };
    let (parent, child) = (fields.name()?, fields.name()?);
    let parent_from_child = in_space(Pose::new(x_m, y_m, heading_rad));
    Ok(OdometryReading { transform: StampedTransform { stamp_ns, parent, child, parent_from_child }, twist })
}

/// A pose of the plane in space.
pub(crate) fn in_space(pose: Pose) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, pose.heading_rad);
    Isometry3::from_parts(Translation3::new(pose.x_m, pose.y_m, 0.0), rotation)
}

fn read_transforms(fields: &mut Fields<'_>) -> Result<TransformsReading, FrameProblem> {
    let (flags, count) = (fields.u32()?, fields.u32()?);
    let mut transforms = Vec::new();
    for _ in 0..count {
        let stamp_ns = fields.i64()?;
        let (position, rotation) = (fields.finite()?, fields.finite()?);
        let parent_from_child = pose_in_space(position, rotation).ok_or(FrameProblem::NotFinite)?;
        let (parent, child) = (fields.name()?, fields.name()?);
        transforms.push(StampedTransform { stamp_ns, parent, child, parent_from_child });
    }
    Ok(TransformsReading { is_static: flags & STATIC != 0, transforms })
}

const _: () = assert!(4 * BEAMS_MAX < FRAME_BYTES_MAX);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_frames::every_kind;
    use proptest::prelude::*;

    fn fields(frame: &SensorFrame) -> (u16, Vec<u8>) {
        let mut bytes = Vec::new();
        frame.write_binary(&mut bytes);
        let header = FrameHeader::read(bytes[..HEADER_BYTES].try_into().unwrap());
        assert_eq!(header.length, bytes.len() - HEADER_BYTES);
        (header.kind, bytes.split_off(HEADER_BYTES))
    }

    #[test]
    fn every_frame_survives_as_bytes_and_none_that_was_cut() {
        for frame in every_kind() {
            let (kind, bytes) = fields(&frame);
            assert_eq!(read_binary(kind, &bytes), Ok(frame.clone()));
            for cut in 0..bytes.len() {
                assert!(read_binary(kind, &bytes[..cut]).is_err(), "{frame:?} cut at {cut}");
            }
            assert_eq!(read_binary(kind, &[&bytes[..], &[0]].concat()), Err(FrameProblem::WrongLength));
            assert_eq!(read_binary(77, &bytes), Err(FrameProblem::UnknownKind(77)));
        }
    }

    #[test]
    fn numbers_that_are_none_are_refused_where_they_matter() {
        let [scan, odometry, ..] = every_kind();
        let SensorFrame::Scan(mut scan) = scan else { panic!() };
        scan.scan.scan.numbers[4] = f32::NAN;
        let (kind, bytes) = fields(&SensorFrame::Scan(scan));
        assert_eq!(read_binary(kind, &bytes), Err(FrameProblem::NotFinite), "an angle");
        let (kind, mut bytes) = fields(&odometry);
        bytes[12..20].copy_from_slice(&f64::NAN.to_le_bytes());
        assert_eq!(read_binary(kind, &bytes), Err(FrameProblem::NotFinite));
    }

    proptest! {
        #[test]
        fn any_fields_are_survived(kind in 0u16..6, bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = read_binary(kind, &bytes);
        }
    }
}
