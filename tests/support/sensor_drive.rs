//! Simulated drives as what sensors say: frames of scans, odometry and transforms.

use super::ros_recording::{RosRecording, in_space};
use flockslam::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
use flockslam_lidar_ingest::carmen::write_scan;
use flockslam_messages::ScanBuffer;
use flockslam_sensor_stream::{FramedScan, LidarScan, SensorFrame, TransformsReading};
use flockslam_simulation::{Settings, Simulation, World};
use flockslam_transforms::{Isometry3, StampedTransform};
use std::io::Write;
use std::path::Path;

/// A lidar: its name, where it sits, and that it gives a scan with every so many turns.
#[derive(Clone, Copy)]
pub struct DrivenLidar {
    pub name: &'static str,
    pub place: Pose,
    pub every: usize,
}

/// A drive: its frames in the order of time, and the exact poses at the times of the turns.
pub struct SensorDrive {
    pub frames: Vec<SensorFrame>,
    pub truth: Vec<TrajectoryPoint>,
}

fn transforms(
    is_static: bool,
    parent: &str,
    child: &str,
    stamp_ns: i64,
    pose: Isometry3<f64>,
) -> SensorFrame {
    let (parent, child) = (parent.to_owned(), child.to_owned());
    let transforms = vec![StampedTransform { stamp_ns, parent, child, parent_from_child: pose }];
    SensorFrame::Transforms(TransformsReading { is_static, transforms })
}

/// When something was measured, nanoseconds.
pub fn stamp_ns(frame: &SensorFrame) -> i64 {
    match frame {
        SensorFrame::Scan(scan) => scan.scan.scan.header.times.sensor_ns,
        SensorFrame::Odometry(reading) => reading.transform.stamp_ns,
        SensorFrame::Transforms(reading) if reading.is_static => 0,
        SensorFrame::Transforms(reading) => reading.transforms[0].stamp_ns,
        SensorFrame::Imu(reading) => reading.stamp_ns,
    }
}

impl SensorDrive {
    /// A drive with these lidars, each in the frame of its name; transforms have the odometry.
    pub fn new(settings: &Settings, lidars: &[DrivenLidar]) -> Self {
        let place = |lidar: &DrivenLidar| transforms(true, "base_link", lidar.name, 0, in_space(lidar.place));
        let (mut frames, mut truth): (Vec<_>, _) = (lidars.iter().map(place).collect(), Vec::new());
        let simulated = |lidar: &DrivenLidar| {
            Simulation::new(settings, World::built_in(settings)).unwrap().mounted(lidar.place)
        };
        let mut drives: Vec<_> = lidars.iter().map(simulated).collect();
        for turn in 0..drives[0].scans() {
            for (number, (lidar, drive)) in lidars.iter().zip(&mut drives).enumerate() {
                let mut scan = ScanBuffer::default();
                let map_from_base = drive.next_scan(&mut scan).unwrap();
                let stamp_ns = scan.header.times.sensor_ns;
                if number == 0 {
                    let pose = in_space(scan.header.odometry);
                    frames.push(transforms(false, "odom", "base_link", stamp_ns, pose));
                    truth.push(TrajectoryPoint { stamp_ns, map_from_base });
                }
                if turn.is_multiple_of(lidar.every) {
                    frames.push(scan_of(lidar.name, &scan));
                }
            }
        }
        Self { frames, truth }
    }

    /// The same, as if all beams of a scan were taken at once.
    pub fn with_beams_at_once(&self) -> Self {
        let mut frames = self.frames.clone();
        for frame in &mut frames {
            if let SensorFrame::Scan(scan) = frame {
                scan.scan.scan.header.time_increment_s = 0.0;
            }
        }
        Self { frames, truth: self.truth.clone() }
    }

    /// As bytes of a stream.
    pub fn bytes(&self, write: impl Fn(&SensorFrame, &mut Vec<u8>)) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.frames.iter().for_each(|frame| write(frame, &mut bytes));
        bytes
    }

    /// Writes it as a recorder of ROS 2 would.
    pub fn record(&self, path: &Path) {
        let mut recording = RosRecording::create(path);
        for frame in &self.frames {
            match frame {
                SensorFrame::Scan(scan) => {
                    recording.scan(&format!("/{}", scan.lidar), &scan.scan.frame, &scan.scan.scan);
                }
                SensorFrame::Transforms(reading) => {
                    for StampedTransform { stamp_ns, parent, child, parent_from_child } in &reading.transforms
                    {
                        if reading.is_static {
                            recording.static_transform(parent, child, parent_from_child);
                        } else {
                            recording.transform(*stamp_ns, parent, child, parent_from_child);
                        }
                    }
                }
                SensorFrame::Odometry(_) | SensorFrame::Imu(_) => unreachable!("a drive has neither"),
            }
        }
        recording.finish();
    }

    /// As lines of CARMEN, of one lidar at this place.
    pub fn carmen(&self, place: Pose) -> Vec<u8> {
        let (mut odometry, mut lines) = (Pose::IDENTITY, Vec::new());
        for frame in &self.frames {
            match frame {
                SensorFrame::Transforms(reading) if !reading.is_static => {
                    odometry = flockslam_transforms::planar(&reading.transforms[0].parent_from_child);
                }
                SensorFrame::Scan(scan) => {
                    let mut scan = scan.scan.scan.clone();
                    (scan.header.base_from_laser, scan.header.odometry) = (place, odometry);
                    scan.header.has_odometry = 1;
                    write_scan(&mut lines, scan.view().unwrap()).unwrap();
                }
                _ => {}
            }
        }
        lines.flush().unwrap();
        lines
    }
}

/// The scan of a lidar in the frame of its name, with angles that a message of ROS can say.
fn scan_of(lidar: &str, scan: &ScanBuffer) -> SensorFrame {
    let half_degrees = |angle_rad: f64| (0.5 * (2.0 * angle_rad.to_degrees()).round()).to_radians();
    let mut said = ScanBuffer { numbers: scan.numbers.clone(), ..ScanBuffer::default() };
    let (header, from) = (&mut said.header, &scan.header);
    header.times.sensor_ns = from.times.sensor_ns;
    header.angle_min_rad = half_degrees(from.angle_min_rad);
    header.angle_increment_rad = half_degrees(from.angle_increment_rad);
    (header.time_increment_s, header.beam_count) = (from.time_increment_s, from.beam_count);
    (header.range_min_m, header.range_max_m) = (from.range_min_m.max(0.05), from.range_max_m);
    let scan = FramedScan { frame: lidar.to_owned(), scan: said, mounting: None };
    SensorFrame::Scan(LidarScan { lidar: lidar.to_owned(), scan })
}
