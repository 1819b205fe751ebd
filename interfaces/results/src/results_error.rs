//! Why a file of a run could not be read or written.

use std::path::PathBuf;

/// A file of a run that could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ResultsError {
    /// A log or a replaced file failed.
    #[error(transparent)]
    Journal(#[from] flockslam_journal::JournalError),
    /// Another file failed, or what it holds is damaged.
    #[error("{path}: {reason}")]
    File {
        /// Which file.
        path: PathBuf,
        /// What was wrong.
        reason: String,
    },
}

impl ResultsError {
    /// A problem with a file.
    pub fn file(path: impl Into<PathBuf>, reason: impl std::fmt::Display) -> Self {
        Self::File { path: path.into(), reason: reason.to_string() }
    }
}
