//! ROS 1 bags: `sensor_msgs/LaserScan` messages become scans, `nav_msgs/Odometry` their odometry.
//!
//! The records of a file are looked through ([`check_bag`]) before anything else reads it: no length is believed that leads out of the
//! file, and no chunk that claims to be huge is unpacked.

mod check;
mod ros_messages;

pub use check::{BagProblem, check_bag};
pub use ros_messages::{MessageProblem, OdometryMessage, laser_scan, odometry};

/// What every bag begins with, whatever its version.
pub const MAGIC: &[u8] = b"#ROSBAG V";
