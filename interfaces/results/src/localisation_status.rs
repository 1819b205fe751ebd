//! The belief of a robot about its pose in a known map, as a file that the command line, the live page and the ROS bridge read.

use crate::ResultsError;
use flockslam_journal::{Durability, replace_file};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};

/// The belief, as JSON beside the heartbeats.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocalisationStatus {
    /// `unknown`, `ambiguous` or `localized`.
    pub knowledge: String,
    /// Sensor stamp of the scan that the belief is of, nanoseconds.
    pub stamp_ns: i64,
    /// Where it may be, the most likely first.
    pub hypotheses: Vec<HypothesisRow>,
    /// Entropy of their weights, nat.
    pub entropy_nat: f64,
    /// Covariance of the first in the map's axes, upper triangle over (x, y, heading), while the robot is localized.
    pub covariance: Option<[f64; 6]>,
    /// Searches of the whole map so far.
    pub searches: u64,
    /// Area of the known map, m².
    pub map_area_m2: f64,
}

/// A place where a robot may be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HypothesisRow {
    /// `map_from_base`: metres, metres, radians.
    pub pose: [f64; 3],
    /// Its weight in the belief, 0 … 1.
    pub weight: f64,
    /// Share of the points that the map explains there.
    pub explained: f64,
    /// Share of the points that contradict the map there.
    pub contradicted: f64,
}

/// What localisation did in a whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocalisationSummary {
    /// Scans with a pose in the known map.
    pub localized_scans: u64,
    /// Scans before the robot was found, or after it was lost and before it was found again.
    pub unlocalized_scans: u64,
    /// Way driven until it was found for the first time, metres; `None` when it never was.
    pub found_after_m: Option<f64>,
    /// How often it was found.
    pub found: u64,
    /// Searches of the whole map.
    pub searches: u64,
}

impl LocalisationStatus {
    /// Where it is left.
    pub fn file(status_dir: &Path) -> PathBuf {
        status_dir.join("localisation.json")
    }

    /// Writes it for readers.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, status_dir: &Path) -> Result<(), ResultsError> {
        let path = Self::file(status_dir);
        let json = serde_json::to_vec(self).map_err(|e| ResultsError::file(&path, e))?;
        Ok(replace_file(&path, &json, Durability::Process)?)
    }

    /// What was left last; `None` when the set does not localize.
    pub fn read(status_dir: &Path) -> Option<Self> {
        let json = std::fs::read(Self::file(status_dir)).ok()?;
        serde_json::from_slice(&json).ok()
    }
}

impl fmt::Display for LocalisationStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(first) = self.hypotheses.first() else {
            return write!(f, "{} in the known map ({:.0} m²)", self.knowledge, self.map_area_m2);
        };
        let [x, y, heading] = first.pose;
        let degrees = heading.to_degrees();
        write!(f, "{} in the known map: x {x:.2} m, y {y:.2} m, {degrees:.1}°", self.knowledge)?;
        match (self.covariance, self.hypotheses.len()) {
            (Some([xx, _, _, yy, _, tt]), _) => {
                let sigma_m = xx.max(yy).sqrt();
                write!(f, " ± {sigma_m:.3} m, {:.2}°", tt.sqrt().to_degrees())
            }
            (None, places) => write!(f, " by {:.0} % of {places} places", 100.0 * first.weight),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_left_is_read() {
        let directory = tempfile::tempdir().unwrap();
        assert_eq!(LocalisationStatus::read(directory.path()), None);
        let row = HypothesisRow { pose: [1.0, 2.0, 0.5], weight: 0.9, explained: 0.8, contradicted: 0.01 };
        let status = LocalisationStatus {
            knowledge: "localized".to_owned(),
            hypotheses: vec![row],
            covariance: Some([1e-4, 0.0, 0.0, 4e-4, 0.0, 1e-6]),
            ..LocalisationStatus::default()
        };
        status.write(directory.path()).unwrap();
        assert_eq!(LocalisationStatus::read(directory.path()), Some(status.clone()));
        assert_eq!(
            status.to_string(),
            "localized in the known map: x 1.00 m, y 2.00 m, 28.6° ± 0.020 m, 0.06°"
        );
    }
}
