//! What every message carries: the name of its scan and the times of its scan.

use crate::message::message;

message! {
    /// Names a scan for good: it survives restarts of every stage.
    #[derive(Eq, PartialOrd, Ord, Hash)]
    pub struct ScanId = "flockslam/scan-id/v1" {
        /// Counts the cold starts of the robot's process set.
        pub run: u32,
        /// Which lidar of the robot.
        pub lidar: u32,
        /// Counts the scans of the run in order of arrival, over all lidars, from 0.
        pub sequence: u64,
    }
}

message! {
    /// The three times that every message carries.
    #[derive(Eq)]
    pub struct Times = "flockslam/times/v1" {
        /// Sensor stamp (log time), nanoseconds since the sensor's own zero. It may run backwards. Logic uses only this.
        pub sensor_ns: i64,
        /// CLOCK_MONOTONIC at capture, nanoseconds: latency and deadlines, nothing else.
        pub monotonic_ns: u64,
        /// Wall clock at capture, nanoseconds since 1970 UTC: export only.
        pub utc_ns: i64,
    }
}

impl std::fmt::Display for ScanId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}/{}", self.run, self.lidar, self.sequence)
    }
}
