//! What a run says of where its lidars sit and how far their clocks are off: as data for `report.json`, as a line for people, and as the
//! setting that uses it.

use flockslam_calibration::LidarEstimate;
use flockslam_geometry::{Pose, wrap_angle};
use flockslam_lidar_ingest::LidarCalibration;
use serde::{Deserialize, Serialize};

/// A difference from what was assumed is worth a line when it is greater than this: metres, metres, radians, seconds.
const WORTH: [f64; 4] = [0.02, 0.02, 0.0175, 0.015];
/// And than so many standard deviations.
const SURE: f64 = 3.0;

/// What the motions of a drive tell of one lidar.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CalibrationRow {
    /// Its number.
    pub lidar: u32,
    /// What was assumed in this run: x and y (metres), heading (degrees), offset of its stamps (seconds).
    pub assumed: [f64; 4],
    /// The same as the drive shows it. A number that it does not show is near what was assumed.
    pub estimate: [f64; 4],
    /// Standard deviations of the estimate.
    pub deviation: [f64; 4],
    /// Its covariance, in the same order and units.
    pub covariance: [[f64; 4]; 4],
    /// Which of the four the drive shows well enough to be used.
    pub known: [bool; 4],
    /// Motions that it rests on.
    pub motions: u64,
}

impl CalibrationRow {
    /// Of an estimate; `assumed` and `assumed_offset_s` are what the run was given, and the estimate's offset is what is missing to that.
    pub fn new(lidar: u32, assumed: Pose, assumed_offset_s: f64, estimate: &LidarEstimate) -> Self {
        let degrees = |place: usize| if place == 2 { 1f64.to_degrees() } else { 1.0 };
        let numbers = |pose: Pose, offset_s| [pose.x_m, pose.y_m, pose.heading_rad.to_degrees(), offset_s];
        let covariance =
            |row: usize, column: usize| degrees(row) * degrees(column) * estimate.covariance[(row, column)];
        let deviations = estimate.deviations();
        Self {
            lidar,
            assumed: numbers(assumed, assumed_offset_s),
            estimate: numbers(estimate.base_from_laser, assumed_offset_s + estimate.offset_s),
            deviation: std::array::from_fn(|at| degrees(at) * deviations[at]),
            covariance: std::array::from_fn(|row| std::array::from_fn(|column| covariance(row, column))),
            known: estimate.is_known(),
            motions: estimate.motions as u64,
        }
    }

    /// The setting that uses what is known of it, over what was `configured`.
    pub fn setting(&self, configured: &LidarCalibration) -> LidarCalibration {
        let known = |at: usize, digits: i32| {
            let unit = 10f64.powi(digits);
            self.known[at].then(|| (self.estimate[at] * unit).round() / unit)
        };
        LidarCalibration {
            x_m: known(0, 4).or(configured.x_m),
            y_m: known(1, 4).or(configured.y_m),
            heading_deg: known(2, 3).or(configured.heading_deg),
            offset_s: known(3, 4).unwrap_or(configured.offset_s),
        }
    }

    /// Whether something known differs from what was assumed by more than its uncertainty and more than matters.
    pub fn contradicts(&self) -> bool {
        let differs = |at: usize| {
            let difference = self.estimate[at] - self.assumed[at];
            let (difference, unit) = match at {
                2 => (wrap_angle(difference.to_radians()), 1f64.to_radians()),
                _ => (difference, 1.0),
            };
            let limit = WORTH[at].max(SURE * unit * self.deviation[at]);
            self.known[at] && difference.abs() > limit
        };
        (0..4).any(differs)
    }

    /// A line for people.
    pub fn line(&self) -> String {
        let number = |at: usize, name: &str, unit: &str, scale: f64, digits: usize| {
            let (value, deviation) = (scale * self.estimate[at], scale * self.deviation[at]);
            if self.known[at] {
                format!("{name} {value:.digits$} ± {deviation:.digits$}{unit}")
            } else {
                format!("{name} not shown by this drive")
            }
        };
        let parts = [
            number(0, "x", " m", 1.0, 3),
            number(1, "y", " m", 1.0, 3),
            number(2, "heading", "°", 1.0, 2),
            number(3, "offset", " ms", 1e3, 0),
        ];
        let [x_m, y_m, heading_deg, offset_s] = self.assumed;
        let assumed = format!("{x_m:.3} m, {y_m:.3} m, {heading_deg:.2}°, {:.0} ms", 1e3 * offset_s);
        let hint = if self.contradicts() { "; lidar_ingest.calibrate=true uses it" } else { "" };
        format!("lidar {} by the drive: {}; assumed {assumed}{hint}\n", self.lidar, parts.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(known: [bool; 4]) -> CalibrationRow {
        CalibrationRow {
            lidar: 1,
            assumed: [0.2, 0.0, -179.0, 0.01],
            estimate: [0.250_04, 0.001, 179.5, 0.05],
            deviation: [0.002, 0.002, 0.1, 0.001],
            known,
            ..CalibrationRow::default()
        }
    }

    #[test]
    fn estimated_parameters_are_reported_and_used_and_others_stay() {
        let row = row([true, false, true, true]);
        let expected = "lidar 1 by the drive: x 0.250 ± 0.002 m, y not shown by this drive, heading 179.50 ± 0.10°, offset 50 ± 1 ms; \
                        assumed 0.200 m, 0.000 m, -179.00°, 10 ms; lidar_ingest.calibrate=true uses it\n";
        assert_eq!(row.line(), expected);
        let configured = LidarCalibration { y_m: Some(0.3), offset_s: 0.01, ..LidarCalibration::default() };
        let setting = row.setting(&configured);
        assert_eq!((setting.x_m, setting.y_m), (Some(0.25), Some(0.3)));
        assert_eq!((setting.heading_deg, setting.offset_s), (Some(179.5), 0.05));
    }

    #[test]
    fn only_what_is_known_contradicts() {
        assert!(row([false, false, true, false]).contradicts(), "1.5° across the half turn");
        assert!(!row([false, true, false, false]).contradicts());
    }
}
