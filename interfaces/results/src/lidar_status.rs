//! Status of each lidar of a robot, as lidar-ingest writes it.

use crate::ResultsError;
use flockslam_journal::{Durability, replace_file};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// How a lidar is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LidarStatus {
    /// Its name: that of its driver, the topic of a recording, else its number.
    pub lidar: String,
    /// Scans that the present process of lidar-ingest has given to the set.
    pub scans: u64,
    /// When the last one was, CLOCK_MONOTONIC nanoseconds.
    pub last_ns: u64,
}

/// A lidar that gave no scan for so long is silent, nanoseconds: even slow ones turn once a second.
const SILENT_NS: u64 = 3_000_000_000;

impl LidarStatus {
    /// Since its last scan, seconds.
    pub fn age_s(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.last_ns) as f64 * 1e-9
    }

    /// Whether it gave no scan for too long.
    pub fn is_silent(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.last_ns) > SILENT_NS
    }

    /// Writes the status of all lidars for readers.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(lidars: &[Self], status_dir: &Path) -> Result<(), ResultsError> {
        let path = file(status_dir);
        let json = serde_json::to_vec(lidars).map_err(|e| ResultsError::file(&path, e))?;
        Ok(replace_file(&path, &json, Durability::Process)?)
    }

    /// How they were last, by number; none before the first scan.
    pub fn read(status_dir: &Path) -> Vec<Self> {
        let json = std::fs::read(file(status_dir)).unwrap_or_default();
        serde_json::from_slice(&json).unwrap_or_default()
    }
}

fn file(status_dir: &Path) -> PathBuf {
    status_dir.join("lidars.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_left_is_read() {
        let directory = tempfile::tempdir().unwrap();
        assert_eq!(LidarStatus::read(directory.path()), []);
        let front = LidarStatus { lidar: "front".to_owned(), scans: 7, last_ns: 5 };
        LidarStatus::write(std::slice::from_ref(&front), directory.path()).unwrap();
        assert_eq!(LidarStatus::read(directory.path()), [front]);
    }
}
