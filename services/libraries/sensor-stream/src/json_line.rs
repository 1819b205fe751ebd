//! Lines of JSON: the same frames for programs that have no bytes at hand. Numbers that JSON does not have are `null`.

use crate::FrameProblem;
use crate::binary_frame::{checked_name, in_space, sound};
use crate::readings::{
    BEAMS_MAX, FramedScan, ImuReading, LidarScan, OdometryReading, SensorFrame, TransformsReading,
};
use flockslam_geometry::{Pose, Twist};
use flockslam_messages::{ScanBuffer, ScanSections};
use flockslam_transforms::{Mounting, StampedTransform, planar, pose_in_space};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A line: an object with one key, the kind.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Scan(ScanLine),
    Odometry(OdometryLine),
    Transforms(TransformsLine),
    Imu(ImuLine),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScanLine {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    lidar: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    frame: String,
    stamp_ns: i64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mounting: Option<MountingLine>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    angle_min_rad: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    angle_increment_rad: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    angles_rad: Option<Vec<f32>>,
    #[serde(default)]
    time_increment_s: f32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    times_s: Option<Vec<f32>>,
    #[serde(default)]
    range_min_m: f32,
    range_max_m: f32,
    ranges_m: Vec<Option<f32>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    intensities: Option<Vec<f32>>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MountingLine {
    #[serde(default)]
    x_m: f64,
    #[serde(default)]
    y_m: f64,
    #[serde(default)]
    heading_rad: f64,
    #[serde(default)]
    upside_down: bool,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OdometryLine {
    stamp_ns: i64,
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    twist: Option<TwistLine>,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    parent: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    child: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TwistLine {
    x_m_s: f64,
    #[serde(default)]
    y_m_s: f64,
    turn_rad_s: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TransformsLine {
    #[serde(default, rename = "static")]
    is_static: bool,
    transforms: Vec<TransformLine>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TransformLine {
    #[serde(default)]
    stamp_ns: i64,
    parent: String,
    child: String,
    translation_m: [f64; 3],
    rotation_xyzw: [f64; 4],
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ImuLine {
    stamp_ns: i64,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    frame: String,
    turn_rad_s: Turn,
}

/// About three axes, or about the vertical one alone.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Turn {
    Vertical(f64),
    Axes([f64; 3]),
}

impl SensorFrame {
    /// Appends the frame as a line of JSON, its end included.
    pub fn write_json(&self, to: &mut Vec<u8>) {
        let line = match self {
            Self::Scan(reading) => Line::Scan(scan_line(reading)),
            Self::Odometry(reading) => {
                let StampedTransform { stamp_ns, parent, child, parent_from_child } = &reading.transform;
                let Pose { x_m, y_m, heading_rad } = planar(parent_from_child);
                let twist = reading.twist.map(|twist| TwistLine {
                    x_m_s: twist.x_m_s,
                    y_m_s: twist.y_m_s,
                    turn_rad_s: twist.turn_rad_s,
                });
                let (parent, child) = (parent.clone(), child.clone());
                Line::Odometry(OdometryLine {
                    stamp_ns: *stamp_ns,
                    x_m,
                    y_m,
                    heading_rad,
                    twist,
                    parent,
                    child,
                })
            }
            Self::Transforms(reading) => Line::Transforms(TransformsLine {
                is_static: reading.is_static,
                transforms: reading.transforms.iter().map(transform_line).collect(),
            }),
            Self::Imu(reading) => Line::Imu(ImuLine {
                stamp_ns: reading.stamp_ns,
                frame: reading.frame.clone(),
                turn_rad_s: Turn::Axes(reading.turn_rad_s.into()),
            }),
        };
        serde_json::to_writer(&mut *to, &line).expect("numbers and texts can be written into memory");
        to.push(b'\n');
    }
}

fn transform_line(transform: &StampedTransform) -> TransformLine {
    let pose = &transform.parent_from_child;
    TransformLine {
        stamp_ns: transform.stamp_ns,
        parent: transform.parent.clone(),
        child: transform.child.clone(),
        translation_m: pose.translation.vector.into(),
        rotation_xyzw: pose.rotation.coords.into(),
    }
}

fn scan_line(reading: &LidarScan) -> ScanLine {
    let FramedScan { frame, scan, mounting } = &reading.scan;
    let (header, beams) = (&scan.header, scan.header.beam_count as usize);
    let mut lists = scan.numbers.chunks(beams.max(1)).skip(1);
    let mut section = |bit: u32| {
        (header.sections & bit != 0).then(|| lists.next().map(<[f32]>::to_vec).unwrap_or_default())
    };
    let (angles_rad, intensities, times_s) =
        (section(ScanSections::ANGLES), section(ScanSections::INTENSITIES), section(ScanSections::TIMES));
    let even = |angle_rad: f64| angles_rad.is_none().then_some(angle_rad);
    ScanLine {
        lidar: reading.lidar.clone(),
        frame: frame.clone(),
        stamp_ns: header.times.sensor_ns,
        mounting: mounting.map(|mounting| MountingLine {
            x_m: mounting.base_from_laser.x_m,
            y_m: mounting.base_from_laser.y_m,
            heading_rad: mounting.base_from_laser.heading_rad,
            upside_down: mounting.upside_down,
        }),
        angle_min_rad: even(header.angle_min_rad),
        angle_increment_rad: even(header.angle_increment_rad),
        angles_rad,
        time_increment_s: header.time_increment_s,
        times_s,
        range_min_m: header.range_min_m,
        range_max_m: header.range_max_m,
        ranges_m: scan.numbers.iter().take(beams).map(|m| m.is_finite().then_some(*m)).collect(),
        intensities,
    }
}

/// The frame of a line, without its end.
pub(crate) fn read_json(line: &[u8]) -> Result<SensorFrame, FrameProblem> {
    let line: Line = serde_json::from_slice(line).map_err(|error| FrameProblem::Json(error.to_string()))?;
    match line {
        Line::Scan(line) => read_scan(line).map(SensorFrame::Scan),
        Line::Odometry(line) => read_odometry(line).map(SensorFrame::Odometry),
        Line::Transforms(line) => {
            let transforms = line.transforms.into_iter().map(read_transform).collect::<Result<_, _>>()?;
            Ok(SensorFrame::Transforms(TransformsReading { is_static: line.is_static, transforms }))
        }
        Line::Imu(line) => {
            let turn_rad_s = match line.turn_rad_s {
                Turn::Vertical(rate) => Vector3::new(0.0, 0.0, rate),
                Turn::Axes(rates) => Vector3::from(rates),
            };
            let frame = checked_name(line.frame)?;
            Ok(SensorFrame::Imu(ImuReading { stamp_ns: line.stamp_ns, frame, turn_rad_s }))
        }
    }
}

fn read_scan(line: ScanLine) -> Result<LidarScan, FrameProblem> {
    let beams = line.ranges_m.len();
    if beams == 0 || beams > BEAMS_MAX {
        return Err(FrameProblem::BeamCount);
    }
    if line.angles_rad.is_none() && (line.angle_min_rad.is_none() || line.angle_increment_rad.is_none()) {
        let missing = "a scan needs angle_min_rad and angle_increment_rad, or angles_rad";
        return Err(FrameProblem::Json(missing.to_owned()));
    }
    // A beam that has no number has no return.
    let numbers = line.ranges_m.iter().map(|range| range.unwrap_or(f32::INFINITY)).collect();
    let mut scan = ScanBuffer { numbers, ..ScanBuffer::default() };
    for (list, bit) in [
        (line.angles_rad, ScanSections::ANGLES),
        (line.intensities, ScanSections::INTENSITIES),
        (line.times_s, ScanSections::TIMES),
    ] {
        let Some(list) = list else { continue };
        if list.len() != beams {
            return Err(FrameProblem::UnequalLists);
        }
        scan.header.sections |= bit;
        scan.numbers.extend(list);
    }
    let header = &mut scan.header;
    (header.times.sensor_ns, header.beam_count) = (line.stamp_ns, beams as u32);
    header.angle_min_rad = line.angle_min_rad.unwrap_or_default();
    header.angle_increment_rad = line.angle_increment_rad.unwrap_or_default();
    header.time_increment_s = line.time_increment_s;
    (header.range_min_m, header.range_max_m) = (line.range_min_m, line.range_max_m);
    let mounting = line.mounting.map(|given| Mounting {
        base_from_laser: Pose::new(given.x_m, given.y_m, given.heading_rad),
        upside_down: given.upside_down,
    });
    let scan = FramedScan { frame: checked_name(line.frame)?, scan: sound(scan)?, mounting };
    Ok(LidarScan { lidar: checked_name(line.lidar)?, scan })
}

fn read_odometry(line: OdometryLine) -> Result<OdometryReading, FrameProblem> {
    let (parent, child) = (checked_name(line.parent)?, checked_name(line.child)?);
    let parent_from_child = in_space(Pose::new(line.x_m, line.y_m, line.heading_rad));
    let twist = line.twist.map(|twist| Twist {
        x_m_s: twist.x_m_s,
        y_m_s: twist.y_m_s,
        turn_rad_s: twist.turn_rad_s,
    });
    let transform = StampedTransform { stamp_ns: line.stamp_ns, parent, child, parent_from_child };
    Ok(OdometryReading { transform, twist })
}

fn read_transform(line: TransformLine) -> Result<StampedTransform, FrameProblem> {
    let pose = pose_in_space(line.translation_m, line.rotation_xyzw);
    let parent_from_child = pose.ok_or(FrameProblem::NotFinite)?;
    let (parent, child) = (checked_name(line.parent)?, checked_name(line.child)?);
    Ok(StampedTransform { stamp_ns: line.stamp_ns, parent, child, parent_from_child })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_frames::every_kind;

    #[test]
    fn every_frame_survives_as_a_line() {
        for frame in every_kind() {
            let mut line = Vec::new();
            frame.write_json(&mut line);
            assert_eq!(line.pop(), Some(b'\n'));
            assert_eq!(read_json(&line), Ok(frame), "{}", String::from_utf8_lossy(&line));
        }
    }

    #[test]
    fn a_short_line_is_enough() {
        let line = br#"{"scan":{"stamp_ns":5,"angle_min_rad":-1,"angle_increment_rad":0.5,"range_max_m":8,"ranges_m":[1,null]}}"#;
        let Ok(SensorFrame::Scan(found)) = read_json(line) else { panic!("not a scan") };
        let view = found.scan.scan.view().unwrap();
        assert_eq!((found.lidar.as_str(), view.angle_rad(1), view.ranges()[1]), ("", -0.5, f32::INFINITY));
        let Ok(SensorFrame::Imu(found)) = read_json(br#"{"imu":{"stamp_ns":5,"turn_rad_s":0.5}}"#) else {
            panic!("not an IMU")
        };
        assert_eq!(found.turn_rad_s, Vector3::new(0.0, 0.0, 0.5));
    }

    #[test]
    fn invalid_lines_give_the_reason() {
        for (line, reason) in [
            (r#"{"scan":{"stamp_ns":5}}"#, "missing field"),
            (r#"{"scans":{}}"#, "unknown variant"),
            (r#"{"imu":{"stamp_ns":5,"turn_rad_s":0,"bias":1}}"#, "unknown field"),
            (r#"{"scan":{"stamp_ns":5,"range_max_m":8,"ranges_m":[1]}}"#, "angle_min_rad"),
            (
                r#"{"scan":{"stamp_ns":5,"range_max_m":8,"angles_rad":[0,1],"ranges_m":[1]}}"#,
                "different lengths",
            ),
            (r#"{"scan":{"stamp_ns":5,"range_max_m":8,"angles_rad":[],"ranges_m":[]}}"#, "number of beams"),
            (r#"{"odometry":{"stamp_ns":5.5,"x_m":0,"y_m":0,"heading_rad":0}}"#, "invalid type"),
            ("{", "EOF"),
        ] {
            let found = read_json(line.as_bytes()).unwrap_err().to_string();
            assert!(found.contains(reason), "{line}: {found}");
        }
    }
}
