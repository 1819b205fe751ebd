//! Whether a set makes a map or localizes in one, as a file that outlives all processes: the supervisor writes it, the other processes read it.

use crate::ResultsError;
use flockslam_journal::{Durability, replace_file};
use serde::{Deserialize, Serialize};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The file is looked at this often.
const LOOK: Duration = Duration::from_millis(100);

/// What a set does with its map, as JSON among its results: a set that is killed keeps them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetMode {
    /// It localizes in the known map; otherwise it makes a map.
    pub localizes: bool,
    /// Why no map can be made in the frame of the known map; `None` when the submaps that it consists of are in the set.
    pub fixed: Option<String>,
    /// The known map was given when the set was started.
    pub given: bool,
    /// The mode has been changed since.
    pub changed: bool,
}

impl SetMode {
    /// Where it is left.
    pub fn file(result_dir: &Path) -> PathBuf {
        result_dir.join("mode.json")
    }

    /// Its name, as the command line has it.
    pub fn name(&self) -> &'static str {
        if self.localizes { "localize" } else { "map" }
    }

    /// Leaves it for the processes of the set.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, result_dir: &Path) -> Result<(), ResultsError> {
        let path = Self::file(result_dir);
        let json = serde_json::to_vec(self).map_err(|e| ResultsError::file(&path, e))?;
        Ok(replace_file(&path, &json, Durability::Process)?)
    }

    /// What was left last; `None` when the mode of the set does not change.
    pub fn read(result_dir: &Path) -> Option<Self> {
        let json = fs::read(Self::file(result_dir)).ok()?;
        serde_json::from_slice(&json).ok()
    }
}

/// Follows the mode of a set.
#[derive(Debug)]
pub struct ModeWatch {
    result_dir: PathBuf,
    file: PathBuf,
    looked: Option<Instant>,
    version: Option<(u64, i64, i64)>,
    localizes: bool,
}

impl ModeWatch {
    /// Of the set with these results; `localizes` counts while nothing is said there.
    pub fn of(result_dir: &Path, localizes: bool) -> Self {
        let file = SetMode::file(result_dir);
        Self { result_dir: result_dir.to_owned(), file, looked: None, version: None, localizes }
    }

    /// Whether the set localizes, as of at most a tenth of a second ago.
    pub fn localizes(&mut self) -> bool {
        if self.looked.is_none_or(|looked| looked.elapsed() >= LOOK) {
            self.looked = Some(Instant::now());
            let version = fs::metadata(&self.file).ok().map(|m| (m.ino(), m.mtime(), m.mtime_nsec()));
            if version != self.version {
                self.version = version;
                self.localizes =
                    SetMode::read(&self.result_dir).map_or(self.localizes, |mode| mode.localizes);
            }
        }
        self.localizes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mode_reaches_present_and_later_readers() {
        let directory = tempfile::tempdir().unwrap();
        let mut early = ModeWatch::of(directory.path(), true);
        assert!(early.localizes() && SetMode::read(directory.path()).is_none());
        for localizes in [false, true, false] {
            let mode = SetMode { localizes, ..SetMode::default() };
            mode.write(directory.path()).unwrap();
            assert_eq!(SetMode::read(directory.path()), Some(mode));
            assert_eq!(ModeWatch::of(directory.path(), !localizes).localizes(), localizes);
            early.looked = None;
            assert_eq!(early.localizes(), localizes);
        }
    }
}
