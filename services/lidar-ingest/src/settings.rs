//! Settings of the stage, section `[lidar_ingest]` of the configuration.

use flockslam_geometry::Pose;
use flockslam_transforms::Isometry3;
use nalgebra::{Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Ranges below are not returns, metres: nothing is nearer to a lidar than its own housing, and sensors write 0 for "no return".
pub(crate) const RANGE_MIN_M: f32 = 0.05;
/// More beams than this are refused before any memory is taken for them: ten times as many as any known lidar has.
pub(crate) const BEAMS_MAX: u32 = 10_000_000;

/// Section `[lidar_ingest]`: how a log is read, and what an experiment does to it on the way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Ranges above are not returns, metres. A FLASER line does not say what its sensor writes for "no return"; the
    /// values in use are 50.0 and about 81.9 m, real returns of such sensors lie below. ROBOTLASER1 lines say it
    /// themselves and ignore this value.
    pub range_max_m: f32,
    /// Reading ends with an error when more than this share of the lines so far is bad; ten bad lines are always
    /// tolerated unless the share is 0.
    pub max_bad_line_share: f64,
    /// Whether a log that ends in the middle of a line is taken as far as it goes instead of being refused.
    pub accept_truncated: bool,
    /// Topics of a recording that scans are read from, one for each lidar; needed where there is more than one. Without scans of a
    /// planar lidar a topic of point clouds is taken.
    pub scan_topics: Vec<String>,
    /// Topic of a recording that odometry is read from; needed where there is more than one. Without one odometry is taken from `/tf`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub odometry_topic: Option<String>,
    /// Topic of a recording with an IMU whose turns replace those of odometry. Without odometry an IMU is used unasked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu_topic: Option<String>,
    /// Where the lidars of a recording sit, in place of what its transforms say: for each topic of scans a table of `x_m`, `y_m`,
    /// `heading_deg` (metres ahead and to the left of the middle of the robot, degrees counter-clockwise), `upside_down` and `mirrored`.
    pub lidars: Vec<LidarMounting>,
    /// Points of a cloud are taken from so far below to so far above the sensor, metres; never from the floor, where the sensor's height is
    /// known.
    pub cloud_heights_m: [f64; 2],
    /// The robot's own body, which its lidars see: returns within these boxes count as none. Each is the least and the greatest x, the
    /// least and the greatest y in the frame of the robot, metres.
    pub self_mask: Vec<[f64; 4]>,
    /// `flockslam map` reads the recording twice: first to estimate where its lidars sit and how far their stamps are off, then with what the
    /// drive has shown of it. Without it the estimate is reported only.
    pub calibrate: bool,
    /// What an estimate has said, for each lidar a table, over what transforms, logs and `lidars` say: `x_m`, `y_m`, `heading_deg`
    /// (each may be left out), and `offset_s`, which is added to the stamp of a scan of a recording or a log to have its time by the clock of odometry.
    pub calibration: Vec<LidarCalibration>,
    /// Processes of this stage: one reads the source, the others are on standby to go on in its place.
    pub replicas: usize,

    /// Experiment: seed of everything random below.
    pub seed: u64,
    /// Experiment: turns and shifts all odometry so that the first scan's pose is this: metres, metres, radians.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_pose: Option<[f64; 3]>,
    /// Experiment: whether scans carry odometry at all.
    pub odometry: bool,
    /// Experiment: how often, over the whole log, odometry jumps within one scan by up to 1 m and 90°.
    pub odometry_jumps: u32,
    /// Experiment: standard deviation of what is added to odometry's motion with every scan: metres along each axis,
    /// degrees of turn.
    pub odometry_noise: [f64; 2],
    /// Experiment: share of beams that are replaced by a false return at a random range.
    pub beam_noise_share: f64,
    /// Experiment: only every n-th scan is matched; the others are withheld and get a predicted pose.
    pub keep_every: u64,
}

/// Where a lidar sits on the robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarMounting {
    /// Ahead of the middle of the robot, metres.
    pub x_m: f64,
    /// To the left of it, metres.
    pub y_m: f64,
    /// Where it looks, degrees counter-clockwise from straight ahead.
    pub heading_deg: f64,
    /// It hangs upside down: its angles are counted clockwise as seen from above.
    pub upside_down: bool,
    /// Its driver counts angles the wrong way round.
    pub mirrored: bool,
}

/// Estimated calibration of a lidar.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarCalibration {
    /// Ahead of the middle of the robot, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_m: Option<f64>,
    /// To the left of it, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y_m: Option<f64>,
    /// Where the lidar looks, degrees counter-clockwise from straight ahead. Its beams keep their order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heading_deg: Option<f64>,
    /// Added to the stamp of a scan to have its time by the clock of odometry, seconds.
    pub offset_s: f64,
}

impl LidarCalibration {
    /// The mounting of a lidar with its estimated calibration.
    pub(crate) fn corrected(&self, base_from_laser: Pose) -> Pose {
        Pose::new(
            self.x_m.unwrap_or(base_from_laser.x_m),
            self.y_m.unwrap_or(base_from_laser.y_m),
            self.heading_deg.map_or(base_from_laser.heading_rad, f64::to_radians),
        )
    }
}

impl LidarMounting {
    /// `base_from_laser`, in space.
    pub(crate) fn base_from_laser(&self) -> Isometry3<f64> {
        let roll_rad = if self.upside_down { PI } else { 0.0 };
        let rotation = UnitQuaternion::from_euler_angles(roll_rad, 0.0, self.heading_deg.to_radians());
        Isometry3::from_parts(Translation3::new(self.x_m, self.y_m, 0.0), rotation)
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            range_max_m: 49.5,
            max_bad_line_share: 0.01,
            accept_truncated: false,
            scan_topics: Vec::new(),
            odometry_topic: None,
            imu_topic: None,
            lidars: Vec::new(),
            cloud_heights_m: [-0.3, 0.3],
            self_mask: Vec::new(),
            calibrate: false,
            calibration: Vec::new(),
            replicas: 1,
            seed: 1,
            start_pose: None,
            odometry: true,
            odometry_jumps: 0,
            odometry_noise: [0.0, 0.0],
            beam_noise_share: 0.0,
            keep_every: 1,
        }
    }
}

impl Settings {
    /// What is added to the stamps of a lidar to have its times by the clock of odometry, nanoseconds.
    pub(crate) fn offset_ns(&self, lidar: u32) -> i64 {
        let calibration = self.calibration.get(lidar as usize);
        calibration.map_or(0, |calibration| (calibration.offset_s * 1e9).round() as i64)
    }

    /// Says which setting is out of its range, and what the range is.
    ///
    /// # Errors
    /// `Err` with the name of the setting and its range.
    pub fn check(&self) -> Result<(), &'static str> {
        let share = |value: f64| (0.0..=1.0).contains(&value);
        let rules = [
            (self.range_max_m > RANGE_MIN_M, "range_max_m must be above 0.05"),
            (self.range_max_m.is_finite(), "range_max_m must be finite"),
            (share(self.max_bad_line_share), "max_bad_line_share must be between 0 and 1"),
            (
                self.start_pose.is_none_or(|pose| pose.iter().all(|v| v.abs() < 1e8)),
                "start_pose must be finite",
            ),
            (
                self.lidars.len() <= 16 && self.scan_topics.len() <= 16,
                "lidars and scan_topics must be 16 at most",
            ),
            (
                self.cloud_heights_m.is_sorted_by(|a, b| a < b),
                "cloud_heights_m must be two heights, the lower first",
            ),
            (
                self.self_mask.iter().all(|[x, to_x, y, to_y]| x < to_x && y < to_y),
                "self_mask must be boxes: the least and the greatest x, the least and the greatest y",
            ),
            (
                self.lidars.iter().all(|lidar| {
                    [lidar.x_m, lidar.y_m].iter().all(|v| v.abs() < 100.0) && lidar.heading_deg.abs() <= 360.0
                }),
                "lidars must sit within 100 m, with a heading of at most 360°",
            ),
            (
                self.calibration.iter().all(|lidar| {
                    [lidar.x_m, lidar.y_m].iter().flatten().all(|v| v.abs() < 100.0)
                        && lidar.heading_deg.is_none_or(|v| v.abs() <= 360.0)
                        && lidar.offset_s.abs() <= 0.5
                }),
                "calibration must be within 100 m, 360° and 0.5 s",
            ),
            (self.odometry_jumps <= 100_000, "odometry_jumps must be at most 100000"),
            (
                self.odometry_noise.iter().all(|v| (0.0..=180.0).contains(v)),
                "odometry_noise must be between 0 and 180",
            ),
            (share(self.beam_noise_share), "beam_noise_share must be between 0 and 1"),
            (self.keep_every > 0, "keep_every must be at least 1"),
        ];
        rules.into_iter().find(|(kept, _)| !kept).map_or(Ok(()), |(_, rule)| Err(rule))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_named() {
        assert_eq!(Settings::default().check(), Ok(()));
        let good = Settings::default;
        let wrong = [
            (Settings { range_max_m: 0.05, ..good() }, "range_max_m must be above 0.05"),
            (Settings { range_max_m: f32::NAN, ..good() }, "range_max_m must be above 0.05"),
            (Settings { range_max_m: f32::INFINITY, ..good() }, "range_max_m must be finite"),
            (
                Settings { max_bad_line_share: f64::NAN, ..good() },
                "max_bad_line_share must be between 0 and 1",
            ),
            (Settings { start_pose: Some([0.0, f64::INFINITY, 0.0]), ..good() }, "start_pose must be finite"),
            (Settings { odometry_jumps: 100_001, ..good() }, "odometry_jumps must be at most 100000"),
            (Settings { odometry_noise: [0.0, -1.0], ..good() }, "odometry_noise must be between 0 and 180"),
            (Settings { beam_noise_share: 1.1, ..good() }, "beam_noise_share must be between 0 and 1"),
            (
                Settings { cloud_heights_m: [0.3, 0.3], ..good() },
                "cloud_heights_m must be two heights, the lower first",
            ),
            (
                Settings { self_mask: vec![[0.3, -0.3, -0.2, 0.2]], ..good() },
                "self_mask must be boxes: the least and the greatest x, the least and the greatest y",
            ),
            (
                Settings {
                    calibration: vec![LidarCalibration { offset_s: 0.6, ..LidarCalibration::default() }],
                    ..good()
                },
                "calibration must be within 100 m, 360° and 0.5 s",
            ),
            (Settings { keep_every: 0, ..good() }, "keep_every must be at least 1"),
        ];
        for (settings, rule) in wrong {
            assert_eq!(settings.check(), Err(rule));
        }
    }
}
