//! Sensor readings from any source: a recording, a driver, another process.

use flockslam_geometry::Twist;
use flockslam_messages::ScanBuffer;
use flockslam_transforms::{Mounting, StampedTransform};
use nalgebra::Vector3;

/// More beams than this are refused: ten times as many as any known lidar has.
pub const BEAMS_MAX: usize = 10_000_000;
/// No lidar takes longer for a turn, seconds; a driver with a larger value fills the field with something else.
const SWEEP_MAX_S: f32 = 1.2;

/// One reading of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorFrame {
    /// A scan of one of the robot's lidars.
    Scan(LidarScan),
    /// A pose by odometry.
    Odometry(OdometryReading),
    /// Poses of frames.
    Transforms(TransformsReading),
    /// How fast the robot turns.
    Imu(ImuReading),
}

/// A scan, and which lidar took it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LidarScan {
    /// The lidar's name on its robot, at most 255 bytes; may be empty where there is only one.
    pub lidar: String,
    /// The scan.
    pub scan: FramedScan,
}

/// A scan, and the frame that it was taken in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FramedScan {
    /// The lidar's frame.
    pub frame: String,
    /// The scan: stamp of its first beam, angles, times of beams, limits, ranges and intensities. The rest of its header is as new.
    pub scan: ScanBuffer,
    /// Mounting of the lidar, where its driver gives it.
    pub mounting: Option<Mounting>,
}

/// A pose by odometry.
#[derive(Clone, Debug, PartialEq)]
pub struct OdometryReading {
    /// From the frame of odometry to that of the robot.
    pub transform: StampedTransform,
    /// Twist of the robot, in its own frame, where it is given.
    pub twist: Option<Twist>,
}

/// Poses of frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransformsReading {
    /// They hold at all times.
    pub is_static: bool,
    /// The poses.
    pub transforms: Vec<StampedTransform>,
}

/// How fast a frame turns, by its gyroscopes.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuReading {
    /// When it was measured, nanoseconds.
    pub stamp_ns: i64,
    /// The frame of the IMU.
    pub frame: String,
    /// About its three axes, radians a second.
    pub turn_rad_s: Vector3<f64>,
}

/// Whether a lidar may take this time, seconds, between neighbouring beams of a scan with so many. Some drivers put something else there.
pub fn is_plausible_sweep(time_increment_s: f32, beams: usize) -> bool {
    // Written this way round, so that NaN fails.
    time_increment_s.abs() * beams as f32 <= SWEEP_MAX_S
}
