//! The state of the flock, as a file that the command line and the live page read.

use crate::ResultsError;
use flockslam_journal::{Durability, replace_file};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Status of the flock that a robot's sync-manager publishes, as JSON beside the heartbeats.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct FlockStatus {
    /// Name of the flock.
    pub flock: String,
    /// This robot's name and public key, hexadecimal.
    pub robot: String,
    /// Its public key, hexadecimal: what goes into a trust list.
    pub public_key: String,
    /// The log that its records go to.
    pub epoch: u64,
    /// Why the network is not open; `None` when it is.
    pub problem: Option<String>,
    /// Robots that are connected, by their addresses.
    pub peers: Vec<String>,
    /// Of those, robots that are near: records are exchanged with them alone.
    pub near: Vec<String>,
    /// Names of all robots of which something is known, this one among them.
    pub robots: Vec<String>,
    /// Records that are known, and their bytes.
    pub records: (u64, u64),
    /// Hash of these records.
    pub records_hash: String,
    /// Everything that is known has been searched and laid out: the hashes below are those of these records.
    pub converged: bool,
    /// Names of the robots that are part of the common map.
    pub members: Vec<String>,
    /// Whether this robot is one of at least two of them.
    pub merged: bool,
    /// Hash of the common solution and of the map fused in it; equal where the records are. Empty while there is one robot only.
    pub map_hash: String,
    /// Takes this robot's map to the frame of the flock: metres, metres, radians. `None` while it is not merged.
    pub flock_from_map: Option<[f64; 3]>,
    /// Searches for shared places.
    pub searches: u64,
    /// Bytes of messages received.
    pub received_bytes: u64,
    /// Bytes of messages sent.
    pub said_bytes: u64,
    /// The same by robot, in this order.
    pub traffic: BTreeMap<String, (u64, u64)>,
    /// Closures between robots that are used, and those that contradict the rest.
    pub across: (u64, u64),
    /// Messages and records that were dropped, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// The source of this robot has ended.
    pub has_ended: bool,
}

impl FlockStatus {
    /// Writes it for readers.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, status_dir: &Path) -> Result<(), ResultsError> {
        let path = flock_status_file(status_dir);
        let json = serde_json::to_vec(self).map_err(|e| ResultsError::file(&path, e))?;
        Ok(replace_file(&path, &json, Durability::Process)?)
    }

    /// What was left last; `None` when nothing was.
    pub fn read(status_dir: &Path) -> Option<Self> {
        serde_json::from_slice(&std::fs::read(flock_status_file(status_dir)).ok()?).ok()
    }
}

fn flock_status_file(status_dir: &Path) -> PathBuf {
    status_dir.join("flock.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_is_read_as_it_was_written() {
        let directory = tempfile::tempdir().unwrap();
        assert_eq!(FlockStatus::read(directory.path()), None);
        let status = FlockStatus { members: vec!["a".to_owned()], epoch: 3, ..FlockStatus::default() };
        status.write(directory.path()).unwrap();
        assert_eq!(FlockStatus::read(directory.path()), Some(status));
    }
}
