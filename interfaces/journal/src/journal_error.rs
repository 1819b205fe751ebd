//! The reasons for which durable state cannot be written or read.

use std::io;
use std::path::{Path, PathBuf};

/// Why durable state could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The operating system refused: disk full, read-only, no such directory.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The operation that failed, as a verb.
        action: &'static str,
        /// On which file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The file does not begin as a journal does.
    #[error("{} is not a journal", path.display())]
    NotAJournal {
        /// The file.
        path: PathBuf,
    },
    /// The file was written by another version of the format.
    #[error("{} is a journal of version {found}, this build reads version {known}", path.display())]
    UnknownVersion {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The version of this build.
        known: u32,
    },
    /// Another process (or another writer of this one) has the journal open for writing.
    #[error("{} is being written by another process", path.display())]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// A record of this length, or in so many parts, cannot be written.
    #[error("a record of {bytes} bytes in {parts} parts is too large")]
    RecordTooLarge {
        /// Length of its payload.
        bytes: usize,
        /// Parts that it came in.
        parts: usize,
    },
}

impl JournalError {
    /// A conversion for `map_err`.
    pub(crate) fn io<E: Into<io::Error>>(action: &'static str, path: &Path) -> impl FnOnce(E) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source: source.into() }
    }
}
