//! The pause of a set, as a file.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The file is checked this often.
const LOOK: Duration = Duration::from_millis(100);

/// Whether a set is paused: a file in its `status/`, so that it outlives all processes.
#[derive(Debug)]
pub struct Pause {
    file: PathBuf,
    looked: Option<Instant>,
    is_set: bool,
}

impl Pause {
    /// The pause of the set with this status directory.
    pub fn of(status_dir: &Path) -> Self {
        Self { file: file(status_dir), looked: None, is_set: false }
    }

    /// Whether the set is paused, as of at most a tenth of a second ago.
    pub fn is_set(&mut self) -> bool {
        if self.looked.is_none_or(|looked| looked.elapsed() >= LOOK) {
            self.looked = Some(Instant::now());
            self.is_set = self.file.exists();
        }
        self.is_set
    }

    /// Pauses or resumes a set.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn set(status_dir: &Path, rests: bool) -> io::Result<()> {
        let file = file(status_dir);
        if rests {
            return File::create(file).map(drop);
        }
        match fs::remove_file(file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }
}

fn file(status_dir: &Path) -> PathBuf {
    status_dir.join("paused")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_is_seen_by_all_and_may_be_ordered_twice() {
        let directory = tempfile::tempdir().unwrap();
        let is_set = || Pause::of(directory.path()).is_set();
        assert!(!is_set());
        for rests in [true, true, false, false] {
            Pause::set(directory.path(), rests).unwrap();
            assert_eq!(is_set(), rests);
        }
    }
}
