//! Writes MCAP files with messages of ROS 2, as a robot's recorder would: for what no public recording has.

use flockslam_geometry::Pose;
use flockslam_messages::ScanBuffer;
use flockslam_transforms::Isometry3;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use nalgebra::{Point3, UnitQuaternion};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// A recording that is being written.
pub struct RosRecording {
    writer: Writer<BufWriter<File>>,
    channels: BTreeMap<String, u16>,
}

/// Fields in CDR, little endian.
struct Cdr(Vec<u8>);

impl Cdr {
    fn message(stamp_ns: i64, frame: &str) -> Self {
        Self(vec![0, 1, 0, 0]).header(stamp_ns, frame)
    }

    fn header(self, stamp_ns: i64, frame: &str) -> Self {
        let seconds = stamp_ns.div_euclid(1_000_000_000) as u32;
        self.u32(seconds).u32(stamp_ns.rem_euclid(1_000_000_000) as u32).text(frame)
    }

    fn bytes<const N: usize>(mut self, bytes: [u8; N]) -> Self {
        while !(self.0.len() - 4).is_multiple_of(N) {
            self.0.push(0);
        }
        self.0.extend(bytes);
        self
    }

    fn u32(self, value: u32) -> Self {
        self.bytes(value.to_le_bytes())
    }

    fn f32s(self, values: impl IntoIterator<Item = f32>) -> Self {
        values.into_iter().fold(self, |cdr, value| cdr.bytes(value.to_le_bytes()))
    }

    fn f64s(self, values: impl IntoIterator<Item = f64>) -> Self {
        values.into_iter().fold(self, |cdr, value| cdr.bytes(value.to_le_bytes()))
    }

    fn text(self, text: &str) -> Self {
        let mut cdr = self.u32(text.len() as u32 + 1);
        cdr.0.extend(text.as_bytes());
        cdr.0.push(0);
        cdr
    }

    fn pose(self, pose: &Isometry3<f64>) -> Self {
        let (position, rotation) = (pose.translation.vector, pose.rotation.coords);
        self.f64s(position.iter().chain(rotation.iter()).copied())
    }
}

/// A pose of the plane in space.
pub fn in_space(pose: Pose) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, pose.heading_rad);
    Isometry3::from_parts([pose.x_m, pose.y_m, 0.0].into(), rotation)
}

impl RosRecording {
    /// Begins a file.
    pub fn create(path: &Path) -> Self {
        Self::create_with(path, WriteOptions::new())
    }

    /// Begins a file whose chunks are not packed.
    pub fn create_unpacked(path: &Path) -> Self {
        Self::create_with(path, WriteOptions::new().compression(None))
    }

    fn create_with(path: &Path, options: WriteOptions) -> Self {
        let file = BufWriter::new(File::create(path).unwrap());
        let writer = options.profile("ros2").create(file).unwrap();
        Self { writer, channels: BTreeMap::new() }
    }

    fn put(&mut self, topic: &str, type_name: &str, recorded_ns: i64, message: Cdr) {
        let Self { writer, channels } = self;
        let channel_id = *channels.entry(topic.to_owned()).or_insert_with(|| {
            let schema = writer.add_schema(type_name, "ros2msg", b"").unwrap();
            writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
        });
        let (log_time, publish_time) = (recorded_ns as u64, recorded_ns as u64);
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time };
        writer.write_to_known_channel(&header, &message.0).unwrap();
    }

    /// A scan, with what its header says of angles, times, limits and its stamp.
    pub fn scan(&mut self, topic: &str, frame: &str, scan: &ScanBuffer) {
        let header = &scan.header;
        let beams = header.beam_count;
        let last = f64::from(beams.saturating_sub(1));
        let shape = [
            header.angle_min_rad as f32,
            (header.angle_min_rad + last * header.angle_increment_rad) as f32,
            header.angle_increment_rad as f32,
            header.time_increment_s,
            0.1,
            header.range_min_m,
            header.range_max_m,
        ];
        let stamp_ns = header.times.sensor_ns;
        let message = Cdr::message(stamp_ns, frame).f32s(shape).u32(beams);
        let message = message.f32s(scan.numbers[..beams as usize].iter().copied()).u32(0);
        self.put(topic, "sensor_msgs/msg/LaserScan", stamp_ns, message);
    }

    /// `odom_from_base`.
    pub fn odometry(&mut self, stamp_ns: i64, pose: Pose) {
        let message = Cdr::message(stamp_ns, "odom").text("base_link").pose(&in_space(pose));
        let message = message.f64s([0.0; 36 + 6 + 36]);
        self.put("/odom", "nav_msgs/msg/Odometry", stamp_ns, message);
    }

    /// How fast the robot turns.
    pub fn imu(&mut self, stamp_ns: i64, frame: &str, turn_rad_s: [f64; 3]) {
        let message = Cdr::message(stamp_ns, frame).f64s([0.0; 13]).f64s(turn_rad_s).f64s([0.0; 21]);
        self.put("/imu", "sensor_msgs/msg/Imu", stamp_ns, message);
    }

    /// A transform that holds at all times.
    pub fn static_transform(&mut self, parent: &str, child: &str, parent_from_child: &Isometry3<f64>) {
        let message = Cdr(vec![0, 1, 0, 0]).u32(1).header(0, parent).text(child).pose(parent_from_child);
        self.put("/tf_static", "tf2_msgs/msg/TFMessage", 0, message);
    }

    /// A transform that holds at a time.
    pub fn transform(&mut self, stamp_ns: i64, parent: &str, child: &str, pose: &Isometry3<f64>) {
        let message = Cdr(vec![0, 1, 0, 0]).u32(1).header(stamp_ns, parent).text(child).pose(pose);
        self.put("/tf", "tf2_msgs/msg/TFMessage", stamp_ns, message);
    }

    /// Points.
    pub fn cloud(&mut self, frame: &str, stamp_ns: i64, points: &[Point3<f32>]) {
        let message = Cdr::message(stamp_ns, frame).u32(1).u32(points.len() as u32).u32(3);
        let message = ["x", "y", "z"]
            .into_iter()
            .zip([0, 4, 8])
            .fold(message, |message, (name, offset)| message.text(name).u32(offset).bytes([7]).u32(1));
        let size = 12 * points.len() as u32;
        let message = message.bytes([0]).u32(12).u32(size).u32(size);
        let message = points.iter().fold(message, |message, point| message.f32s(point.iter().copied()));
        self.put("/points", "sensor_msgs/msg/PointCloud2", stamp_ns, message.bytes([1]));
    }

    /// Any bytes as a message.
    pub fn raw(&mut self, topic: &str, type_name: &str, stamp_ns: i64, bytes: &[u8]) {
        self.put(topic, type_name, stamp_ns, Cdr(bytes.to_vec()));
    }

    /// Writes the end.
    pub fn finish(mut self) {
        self.writer.finish().unwrap();
    }
}
