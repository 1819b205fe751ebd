//! The log file that all processes of a set append to, with a limit on its size.

use super::log_line::json_line;
use crate::clock::log_time_ns;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// A stream that has grown to this begins anew; what was there before is kept once, beside it.
const BYTES_MAX: u64 = 4 * 1024 * 1024;

/// Where a set whose directory is `runtime` keeps the log lines of all its processes: JSON, one a line.
pub fn log_stream_file(runtime: &Path) -> PathBuf {
    runtime.join("log.jsonl")
}

/// Adds a line to the stream. Many processes do so: a line goes out in one piece.
pub(super) fn append(path: &Path, line: &str, bytes_max: u64) -> io::Result<()> {
    let open = || OpenOptions::new().append(true).create(true).open(path);
    let mut file = open()?;
    if file.metadata()?.len() >= bytes_max && is_at(&file, path) {
        std::fs::rename(path, path.with_extension("old.jsonl"))?;
        file = open()?;
    }
    file.write_all(line.as_bytes())
}

/// Whether this file was not replaced by another one.
fn is_at(file: &File, path: &Path) -> bool {
    let inode = |metadata: io::Result<std::fs::Metadata>| metadata.map(|metadata| metadata.ino()).ok();
    inode(file.metadata()) == inode(std::fs::metadata(path))
}

/// Copies all lines of this process into the stream of its set, once it belongs to one.
pub(super) struct StreamLayer {
    pub(super) stage: String,
    pub(super) path: Arc<OnceLock<PathBuf>>,
}

impl<S: Subscriber> Layer<S> for StreamLayer {
    fn on_event(&self, event: &Event<'_>, _context: Context<'_, S>) {
        if let Some(path) = self.path.get() {
            // Without room for it the line still stands on the standard error.
            let _ = append(path, &json_line(&self.stage, log_time_ns(), event), BYTES_MAX);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_that_has_grown_begins_anew_and_keeps_what_was_before() {
        let directory = tempfile::tempdir().unwrap();
        let path = log_stream_file(directory.path());
        for number in 0..5 {
            append(&path, &format!("line {number}\n"), 14).unwrap();
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "line 4\n");
        assert_eq!(std::fs::read_to_string(path.with_extension("old.jsonl")).unwrap(), "line 2\nline 3\n");
    }
}
