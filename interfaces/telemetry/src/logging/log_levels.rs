//! Log levels of a stage as a file in the set's directory, which its processes read now and then.

use super::set_log_filter;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// A process looks so often whether its levels have changed, nanoseconds.
const PERIOD_NS: u64 = 200_000_000;

/// What a process of a stage shall log, as it is in the set's directory: it holds for the processes that follow too.
#[derive(Debug)]
pub struct LogLevels {
    path: PathBuf,
    looked_ns: Option<u64>,
    seen: Option<(u64, i64, i64)>,
}

impl LogLevels {
    /// Those of a stage.
    pub fn of(status_dir: &Path, stage: &str) -> Self {
        Self { path: file(status_dir, stage), looked_ns: None, seen: None }
    }

    /// Takes over what has changed since the last look; cheap when called often.
    pub fn look(&mut self, now_ns: u64) {
        if self.looked_ns.is_some_and(|looked| now_ns.saturating_sub(looked) < PERIOD_NS) {
            return;
        }
        self.looked_ns = Some(now_ns);
        let found =
            fs::metadata(&self.path).ok().map(|found| (found.ino(), found.mtime(), found.mtime_nsec()));
        if found == self.seen {
            return;
        }
        self.seen = found;
        let filter = fs::read_to_string(&self.path).unwrap_or_default();
        if let Err(problem) = set_log_filter(filter.trim()) {
            tracing::warn!(filter, problem, "log levels are not changed");
        }
    }

    /// Sets what all processes of a stage shall log from now on.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn set(status_dir: &Path, stage: &str, filter: &str) -> io::Result<()> {
        let (path, new) = (file(status_dir, stage), status_dir.join(format!("{stage}.log-levels.new")));
        fs::write(&new, filter)?;
        fs::rename(new, path)
    }
}

fn file(status_dir: &Path, stage: &str) -> PathBuf {
    status_dir.join(format!("{stage}.log-levels"))
}
