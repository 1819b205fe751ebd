//! Messages of sensors in the graph as what a set reads. Pure.

use flockslam_geometry::Twist;
use flockslam_recordings::{LaserScanMessage, MessageProblem};
use flockslam_ros::messages::{Imu, LaserScan, Odometry, Quaternion, TFMessage, Vector3};
use flockslam_sensor_stream::{FramedScan, ImuReading, OdometryReading};
use flockslam_transforms::{Isometry3, StampedTransform};
use nalgebra::{Quaternion as Turn, Translation3, UnitQuaternion};

/// A quaternion that is shorter is no turn.
const NORM_MIN: f64 = 1e-6;

/// A scan.
///
/// # Errors
/// When it has too many beams, or limits that are no numbers.
pub fn scan_of(message: LaserScan) -> Result<FramedScan, MessageProblem> {
    let beams = message.ranges.len();
    let mut numbers = message.ranges;
    numbers.extend(message.intensities);
    let message = LaserScanMessage {
        stamp_ns: message.header.stamp.ns(),
        frame: message.header.frame_id,
        angle_min_rad: message.angle_min,
        angle_increment_rad: message.angle_increment,
        time_increment_s: message.time_increment,
        range_min_m: message.range_min,
        range_max_m: message.range_max,
        beams,
        numbers,
    };
    message.into_scan()
}

/// Transforms; those that are none are left out.
pub fn transforms_of(message: TFMessage) -> Vec<StampedTransform> {
    let one = |transform: flockslam_ros::messages::TransformStamped| {
        let pose = isometry(transform.transform.translation, transform.transform.rotation)?;
        Some(StampedTransform {
            stamp_ns: transform.header.stamp.ns(),
            parent: transform.header.frame_id,
            child: transform.child_frame_id,
            parent_from_child: pose,
        })
    };
    message.transforms.into_iter().filter_map(one).collect()
}

/// Odometry; `None` when it is no pose.
pub fn odometry_of(message: Odometry) -> Option<OdometryReading> {
    let pose = message.pose.pose;
    let twist = message.twist;
    let twist = Twist { x_m_s: twist.linear.x, y_m_s: twist.linear.y, turn_rad_s: twist.angular.z };
    let is_finite = [twist.x_m_s, twist.y_m_s, twist.turn_rad_s].into_iter().all(f64::is_finite);
    Some(OdometryReading {
        transform: StampedTransform {
            stamp_ns: message.header.stamp.ns(),
            parent: message.header.frame_id,
            child: message.child_frame_id,
            parent_from_child: isometry(pose.position, pose.orientation)?,
        },
        twist: is_finite.then_some(twist),
    })
}

/// How fast an IMU turns; `None` when it says no numbers.
pub fn imu_of(message: Imu) -> Option<ImuReading> {
    let rates = message.angular_velocity;
    let turn_rad_s = nalgebra::Vector3::new(rates.x, rates.y, rates.z);
    turn_rad_s.iter().all(|rate| rate.is_finite()).then(|| ImuReading {
        stamp_ns: message.header.stamp.ns(),
        frame: message.header.frame_id,
        turn_rad_s,
    })
}

fn isometry(position: Vector3, turn: Quaternion) -> Option<Isometry3<f64>> {
    let numbers = [position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w];
    let turn = Turn::new(turn.w, turn.x, turn.y, turn.z);
    let is_sound = numbers.iter().all(|number| number.is_finite()) && turn.norm() > NORM_MIN;
    is_sound.then(|| {
        let position = Translation3::new(position.x, position.y, position.z);
        Isometry3::from_parts(position, UnitQuaternion::from_quaternion(turn))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_ros::messages::{Header, Transform, TransformStamped};

    #[test]
    fn a_scan_has_its_beams_and_intensities_where_each_has_one() {
        let mut message = LaserScan {
            header: Header::new(5_000_000_007, "laser"),
            angle_min: -0.5,
            angle_increment: 0.5,
            range_max: 10.0,
            ranges: vec![1.0, f32::INFINITY, 2.0],
            intensities: vec![7.0, 8.0, 9.0],
            ..LaserScan::default()
        };
        let scan = scan_of(message.clone()).unwrap();
        assert_eq!((scan.frame.as_str(), scan.scan.header.times.sensor_ns), ("laser", 5_000_000_007));
        assert_eq!((scan.scan.header.beam_count, scan.scan.numbers.len()), (3, 6));
        message.intensities = vec![1.0];
        assert_eq!(scan_of(message.clone()).unwrap().scan.numbers.len(), 3);
        message.angle_min = f32::NAN;
        assert_eq!(scan_of(message), Err(MessageProblem::NotFinite));
    }

    #[test]
    fn invalid_transforms_are_left_out() {
        let transform = |w: f64, x: f64| TransformStamped {
            header: Header::new(1, "odom"),
            child_frame_id: "base".to_owned(),
            transform: Transform {
                translation: Vector3 { x, y: 0.0, z: 0.0 },
                rotation: Quaternion { x: 0.0, y: 0.0, z: 0.0, w },
            },
        };
        let message = TFMessage {
            transforms: vec![transform(1.0, 2.0), transform(0.0, 2.0), transform(1.0, f64::NAN)],
        };
        let found = transforms_of(message);
        assert_eq!((found.len(), found[0].parent_from_child.translation.x), (1, 2.0));
    }

    #[test]
    fn odometry_and_turns_are_taken_over() {
        let mut message = Odometry { header: Header::new(3, "odom"), ..Odometry::default() };
        message.twist.linear.x = 0.5;
        message.twist.angular.z = 0.1;
        let found = odometry_of(message).unwrap();
        assert_eq!(
            (found.transform.stamp_ns, found.twist),
            (3, Some(Twist { x_m_s: 0.5, y_m_s: 0.0, turn_rad_s: 0.1 }))
        );
        let mut message = Imu::default();
        message.angular_velocity.z = 0.3;
        assert_eq!(imu_of(message.clone()).unwrap().turn_rad_s.z, 0.3);
        message.angular_velocity.x = f64::INFINITY;
        assert_eq!(imu_of(message), None);
    }
}
