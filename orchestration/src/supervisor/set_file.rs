//! `set.json` in the directory of a set. The supervisor writes it, and each stage reads it when it starts.

use crate::configuration::Configuration;
use flockslam_lidar_ingest::process::Source;
use flockslam_stage::{StageError, StageOptions};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The options of a set: the supervisor writes them, every stage reads them when it starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SetFile {
    /// Version of the executable that wrote it.
    pub version: String,
    /// How the set runs.
    pub options: StageOptions,
    /// Where scans come from.
    pub source: Source,
    /// Live replay: log seconds per second.
    pub rate: Option<f64>,
    /// A map to simulate in.
    pub world: Option<PathBuf>,
    /// The whole configuration.
    pub configuration: Configuration,
}

impl SetFile {
    /// Writes it.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, path: &Path) -> Result<(), StageError> {
        let json = serde_json::to_vec_pretty(self).map_err(|e| StageError::file(path, e))?;
        Ok(flockslam_journal::replace_file(path, &json, flockslam_journal::Durability::Process)?)
    }

    /// Reads it.
    ///
    /// # Errors
    /// When it is not there, or another version wrote it.
    pub fn read(path: &Path) -> Result<Self, StageError> {
        let json = std::fs::read(path).map_err(|e| StageError::file(path, e))?;
        let read: Self = serde_json::from_slice(&json).map_err(|e| StageError::file(path, e))?;
        if read.version == crate::VERSION {
            Ok(read)
        } else {
            let reason =
                format!("the set was started by flockslam {}, this is {}", read.version, crate::VERSION);
            Err(StageError::file(path, reason))
        }
    }
}
