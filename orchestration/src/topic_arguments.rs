//! The arguments that say what is read of a recording.

use clap::Args;

/// Topics of a recording that are read.
#[derive(Clone, Debug, Args)]
pub struct TopicArgs {
    /// Topic of the recording that scans are read from; needed where there is more than one; for several lidars given for each
    #[arg(long, value_name = "TOPIC")]
    pub scan: Vec<String>,
    /// Topic of the recording that odometry is read from; needed where there is more than one
    #[arg(long, value_name = "TOPIC")]
    pub odom: Option<String>,
    /// Topic of the recording with an IMU whose turns replace those of odometry
    #[arg(long, value_name = "TOPIC")]
    pub imu: Option<String>,
}

impl TopicArgs {
    /// The settings that say the same.
    pub fn assignments(&self) -> Vec<String> {
        let named = [("odometry_topic", &self.odom), ("imu_topic", &self.imu)];
        let named = named.into_iter().filter_map(|(key, topic)| topic.as_ref().map(|topic| (key, topic)));
        let mut found: Vec<String> =
            named.map(|(key, topic)| format!("lidar_ingest.{key}={topic:?}")).collect();
        if !self.scan.is_empty() {
            found.push(format!("lidar_ingest.scan_topics={:?}", self.scan));
        }
        found
    }
}
