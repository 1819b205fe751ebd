//! Turns scans, poses, transforms, log lines and grids into messages of a recording: JSON by the schemas of Foxglove.

use super::RecordTopic;
use flockslam_geometry::Pose;
use flockslam_geometry::elementary::sin_cos;
use flockslam_messages::{PoseEstimate, ScanView};
use flockslam_recordings::SetRecord;
use serde::Serialize;
use serde_json::Value;

/// A message of a recording: its topic, its time (wall clock, when the scan was put on the bus or the line was logged,
/// nanoseconds), and its bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Where it belongs.
    pub topic: RecordTopic,
    /// Its time.
    pub utc_ns: u64,
    /// JSON by the topic's schema, or a scan as it is on the bus.
    pub data: Vec<u8>,
}

#[derive(Clone, Copy, Serialize)]
pub(super) struct Time {
    sec: u64,
    nsec: u64,
}

#[derive(Clone, Copy, Default, Serialize)]
pub(super) struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

#[derive(Clone, Copy, Serialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// A pose of the plane among those of space.
#[derive(Clone, Copy, Serialize)]
pub(super) struct SpatialPose {
    position: Vector3,
    orientation: Quaternion,
}

impl From<Pose> for SpatialPose {
    fn from(pose: Pose) -> Self {
        let (sin, cos) = sin_cos(pose.heading_rad / 2.0);
        let position = Vector3 { x: pose.x_m, y: pose.y_m, z: 0.0 };
        Self { position, orientation: Quaternion { x: 0.0, y: 0.0, z: sin, w: cos } }
    }
}

#[derive(Serialize)]
struct LaserScan<'a> {
    timestamp: Time,
    frame_id: &'a str,
    pose: SpatialPose,
    start_angle: f64,
    end_angle: f64,
    ranges: Vec<f32>,
    intensities: Vec<f32>,
}

#[derive(Serialize)]
struct PoseInFrame<'a> {
    timestamp: Time,
    frame_id: &'a str,
    pose: SpatialPose,
}

#[derive(Serialize)]
struct FrameTransform<'a> {
    timestamp: Time,
    parent_frame_id: &'a str,
    child_frame_id: &'a str,
    translation: Vector3,
    rotation: Quaternion,
}

#[derive(Serialize)]
struct Log<'a> {
    timestamp: Time,
    level: u8,
    message: String,
    name: &'a str,
    file: &'a str,
    line: u32,
}

#[derive(Serialize)]
struct Grid<'a> {
    timestamp: Time,
    frame_id: &'a str,
    pose: SpatialPose,
    column_count: usize,
    cell_size: CellSize,
    row_stride: usize,
    cell_stride: usize,
    fields: [Field<'a>; 1],
    data: String,
}

#[derive(Serialize)]
struct CellSize {
    x: f64,
    y: f64,
}

#[derive(Serialize)]
struct Field<'a> {
    name: &'a str,
    offset: u32,
    r#type: u8,
}

/// Number of the 8-bit type among those of packed fields.
const UINT8: u8 = 1;

/// A scan, in the frame of the laser. JSON knows no infinities: a beam without a valid return has range 0. Beams lie evenly between
/// the first and the last.
pub fn scan(scan: ScanView<'_>) -> Recorded {
    let finite = |value: &f32| if value.is_finite() { *value } else { 0.0 };
    let range = |beam| scan.valid_range_m(beam).map_or(0.0, |range_m| range_m as f32);
    let last = scan.len().saturating_sub(1);
    let angle = |beam| if scan.is_empty() { 0.0 } else { scan.angle_rad(beam) };
    let utc_ns = wall(scan.header().times.utc_ns);
    let message = LaserScan {
        timestamp: time(utc_ns),
        frame_id: "laser",
        pose: Pose::IDENTITY.into(),
        start_angle: angle(0),
        end_angle: angle(last),
        ranges: (0..scan.len()).map(range).collect(),
        intensities: scan.intensities().map(|values| values.iter().map(finite).collect()).unwrap_or_default(),
    };
    recorded(RecordTopic::Scan, utc_ns, &message)
}

/// A scan as it is on the bus.
pub fn bus_scan(scan: ScanView<'_>) -> Recorded {
    Recorded { topic: RecordTopic::BusScan, utc_ns: wall(scan.header().times.utc_ns), data: scan.bytes() }
}

/// A record of the set, as it is on the bus.
pub fn set_record(utc_ns: i64, record: &SetRecord) -> Recorded {
    Recorded { topic: RecordTopic::SetRecord, utc_ns: wall(utc_ns), data: record.bytes() }
}

/// A pose, in map with the latest correction and in odom.
pub fn pose(pose: &PoseEstimate) -> [Recorded; 2] {
    let utc_ns = wall(pose.times.utc_ns);
    let in_frame = |topic, frame_id, pose: Pose| {
        recorded(topic, utc_ns, &PoseInFrame { timestamp: time(utc_ns), frame_id, pose: pose.into() })
    };
    [
        in_frame(RecordTopic::Pose, "map", pose.map_from_base()),
        in_frame(RecordTopic::OdomPose, "odom", pose.odom_from_base),
    ]
}

/// The frames at a pose: `map ← odom ← base_link ← laser`.
pub fn transforms(pose: &PoseEstimate, base_from_laser: Pose) -> [Recorded; 3] {
    let utc_ns = wall(pose.times.utc_ns);
    let transform = |parent_frame_id, child_frame_id, pose: Pose| {
        let SpatialPose { position: translation, orientation: rotation } = pose.into();
        let timestamp = time(utc_ns);
        let message = FrameTransform { timestamp, parent_frame_id, child_frame_id, translation, rotation };
        recorded(RecordTopic::Transforms, utc_ns, &message)
    };
    [
        transform("map", "odom", pose.map_from_odom),
        transform("odom", "base_link", pose.odom_from_base),
        transform("base_link", "laser", base_from_laser),
    ]
}

/// A line of the set's log stream; `None` when it is none.
pub fn log(line: &str) -> Option<Recorded> {
    let fields = serde_json::from_str::<Value>(line).ok()?;
    let fields = fields.as_object()?;
    let text = |name: &str| fields.get(name).and_then(Value::as_str).unwrap_or_default();
    let utc_ns = fields.get("utc_ns").and_then(Value::as_u64)?;
    let level = match text("level") {
        "ERROR" => 4,
        "WARN" => 3,
        "INFO" => 2,
        "DEBUG" | "TRACE" => 1,
        _ => 0,
    };
    let mut message = text("message").to_owned();
    for (name, value) in fields {
        if !["utc_ns", "level", "stage", "target", "message"].contains(&name.as_str()) {
            message.push_str(&format!(" {name}={value}"));
        }
    }
    let (name, file) = (text("stage"), text("target"));
    let message = Log { timestamp: time(utc_ns), level, message, name, file, line: 0 };
    Some(recorded(RecordTopic::Log, utc_ns, &message))
}

/// A grid of bytes in odom, row by row from the corner of its first cell: 0 is unknown, 1 free, 255 occupied.
pub(super) fn grid(
    utc_ns: i64,
    corner_m: (f64, f64),
    cell_size_m: f64,
    columns: usize,
    cells: &[u8],
) -> Recorded {
    let utc_ns = wall(utc_ns);
    let message = Grid {
        timestamp: time(utc_ns),
        frame_id: "odom",
        pose: Pose::new(corner_m.0, corner_m.1, 0.0).into(),
        column_count: columns,
        cell_size: CellSize { x: cell_size_m, y: cell_size_m },
        row_stride: columns,
        cell_stride: 1,
        fields: [Field { name: "occupancy", offset: 0, r#type: UINT8 }],
        data: data_encoding::BASE64.encode(cells),
    };
    recorded(RecordTopic::Grid, utc_ns, &message)
}

pub(super) fn recorded(topic: RecordTopic, utc_ns: u64, message: &impl Serialize) -> Recorded {
    let json = serde_json::to_vec(message).expect("numbers and texts can always be written");
    Recorded { topic, utc_ns, data: json }
}

pub(super) fn wall(utc_ns: i64) -> u64 {
    u64::try_from(utc_ns).unwrap_or(0)
}

pub(super) fn time(utc_ns: u64) -> Time {
    Time { sec: utc_ns / 1_000_000_000, nsec: utc_ns % 1_000_000_000 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_messages::{ScanBuffer, ScanHeader};

    fn value(recorded: &Recorded) -> Value {
        serde_json::from_slice(&recorded.data).unwrap()
    }

    /// Every property of the schema is there, and nothing else.
    fn assert_fits(recorded: &Recorded) {
        let schema: Value = serde_json::from_str(&recorded.topic.schema()).unwrap();
        let names = |value: &Value| -> Vec<String> {
            let mut names: Vec<_> = value.as_object().unwrap().keys().cloned().collect();
            names.sort();
            names
        };
        assert_eq!(names(&value(recorded)), names(&schema["properties"]), "{:?}", recorded.topic);
    }

    #[test]
    fn messages_have_the_fields_of_their_schemas() {
        let mut header =
            ScanHeader { beam_count: 3, range_min_m: 0.1, range_max_m: 30.0, ..ScanHeader::default() };
        (header.angle_min_rad, header.angle_increment_rad) = (-1.0, 1.0);
        header.times.utc_ns = 1_700_000_000_250_000_000;
        let buffer = ScanBuffer { header, numbers: vec![2.0, f32::INFINITY, 5.0] };
        let laser = scan(buffer.view().unwrap());
        assert_fits(&laser);
        let seen = value(&laser);
        assert_eq!(seen["ranges"], serde_json::json!([2.0, 0.0, 5.0]));
        assert_eq!((seen["start_angle"].as_f64(), seen["end_angle"].as_f64()), (Some(-1.0), Some(1.0)));
        assert_eq!(seen["timestamp"], serde_json::json!({"sec": 1_700_000_000, "nsec": 250_000_000}));

        let estimate = PoseEstimate {
            times: header.times,
            map_from_odom: Pose::new(10.0, 0.0, 0.0),
            odom_from_base: Pose::new(1.0, 2.0, std::f64::consts::PI),
            ..PoseEstimate::default()
        };
        let [in_map, in_odom] = pose(&estimate);
        assert_fits(&in_map);
        assert_eq!(value(&in_map)["pose"]["position"]["x"], 11.0);
        assert_eq!(value(&in_odom)["pose"]["position"]["x"], 1.0);
        // A half turn is ±1, the same orientation.
        let z = value(&in_odom)["pose"]["orientation"]["z"].as_f64().unwrap();
        assert!((z.abs() - 1.0).abs() < 1e-12);
        let frames = transforms(&estimate, Pose::new(0.2, 0.0, 0.0));
        frames.iter().for_each(assert_fits);
        let trajectory: Vec<_> = frames
            .iter()
            .map(|frame| (value(frame)["parent_frame_id"].clone(), value(frame)["child_frame_id"].clone()))
            .collect();
        let expected = [("map", "odom"), ("odom", "base_link"), ("base_link", "laser")];
        assert_eq!(trajectory, expected.map(|(parent, child)| (Value::from(parent), Value::from(child))));

        let map = grid(5, (-1.0, 2.0), 0.05, 2, &[0, 1, 255, 7]);
        assert_fits(&map);
        assert_eq!(value(&map)["data"], "AAH/Bw==");

        let line = log(
            r#"{"utc_ns":7000000001,"level":"WARN","stage":"mapper","target":"t","message":"late","scan":4}"#,
        )
        .unwrap();
        assert_fits(&line);
        assert_eq!(
            (value(&line)["message"].as_str(), value(&line)["level"].as_u64()),
            (Some("late scan=4"), Some(3))
        );
        assert_eq!(log("torn"), None);
    }
}
