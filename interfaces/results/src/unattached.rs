//! What nothing connects with the map so far, as a file that the command line and the live page read.

use crate::ResultsError;
use flockslam_journal::{Durability, replace_file};
use std::fmt;
use std::path::{Path, PathBuf};

/// Scans of trajectories that nothing connects with the map, as JSON beside the heartbeats.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Unattached {
    /// Their number.
    pub scans: u64,
    /// Way driven in these trajectories, metres.
    pub travel_m: f64,
    /// Stamp of the first of them, seconds after the first scan of the run.
    pub since_s: f64,
}

impl Unattached {
    /// Writes it for readers.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, status_dir: &Path) -> Result<(), ResultsError> {
        let path = unattached_file(status_dir);
        let json = serde_json::to_vec(self).map_err(|e| ResultsError::file(&path, e))?;
        Ok(replace_file(&path, &json, Durability::Process)?)
    }

    /// What was left last; `None` when all scans are in the map.
    pub fn read(status_dir: &Path) -> Option<Self> {
        let json = std::fs::read(unattached_file(status_dir)).ok()?;
        serde_json::from_slice(&json).ok().filter(|unattached: &Self| unattached.scans > 0)
    }
}

impl fmt::Display for Unattached {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scans, travel_m, since_s } = self;
        write!(
            f,
            "NOT IN THE MAP: {scans} scans, {travel_m:.0} m, the first {since_s:.0} s after the start, of which \
             nothing says where they belong"
        )
    }
}

fn unattached_file(status_dir: &Path) -> PathBuf {
    status_dir.join("unattached.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_read_as_it_was_written_and_no_scans_are_none() {
        let directory = tempfile::tempdir().unwrap();
        assert_eq!(Unattached::read(directory.path()), None);
        let unattached = Unattached { scans: 218, travel_m: 31.2, since_s: 84.4 };
        unattached.write(directory.path()).unwrap();
        assert_eq!(Unattached::read(directory.path()), Some(unattached));
        assert!(unattached.to_string().starts_with("NOT IN THE MAP: 218 scans, 31 m, the first 84 s"));
        Unattached::default().write(directory.path()).unwrap();
        assert_eq!(Unattached::read(directory.path()), None);
    }
}
