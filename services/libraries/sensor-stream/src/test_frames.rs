//! One frame of each kind, for tests.

use crate::binary_frame::in_space;
use crate::readings::{FramedScan, ImuReading, LidarScan, OdometryReading, SensorFrame, TransformsReading};
use flockslam_geometry::{Pose, Twist};
use flockslam_messages::{ScanBuffer, ScanSections};
use flockslam_transforms::{Mounting, StampedTransform};
use nalgebra::Vector3;

fn transform(child: &str) -> StampedTransform {
    StampedTransform {
        stamp_ns: -5,
        parent: "odom".to_owned(),
        child: child.to_owned(),
        parent_from_child: in_space(Pose::new(1.0, -2.0, 0.0)),
    }
}

pub(crate) fn every_kind() -> [SensorFrame; 4] {
    let mut scan = ScanBuffer::from_ranges(&[1.0, f32::INFINITY, 2.5], 0.0, 0.0);
    scan.header.times.sensor_ns = 1_700_000_000_123_456_789;
    (scan.header.range_min_m, scan.header.range_max_m) = (0.1, 12.0);
    scan.header.sections = ScanSections::ALL;
    scan.numbers.extend([0.0, 0.5, 1.0, 10.0, 20.0, 30.0, 0.0, 0.01, 0.02]);
    let mounting = Mounting { base_from_laser: Pose::new(0.2, 0.0, 3.0), upside_down: true };
    let scan = FramedScan { frame: "laser".to_owned(), scan, mounting: Some(mounting) };
    let twist = Twist { x_m_s: 0.5, y_m_s: 0.0, turn_rad_s: -0.1 };
    [
        SensorFrame::Scan(LidarScan { lidar: "front".to_owned(), scan }),
        SensorFrame::Odometry(OdometryReading { transform: transform("base_link"), twist: Some(twist) }),
        SensorFrame::Transforms(TransformsReading {
            is_static: true,
            transforms: vec![transform("a"), transform("b")],
        }),
        SensorFrame::Imu(ImuReading {
            stamp_ns: 7,
            frame: "imu".to_owned(),
            turn_rad_s: Vector3::new(0.1, 0.2, 0.3),
        }),
    ]
}
