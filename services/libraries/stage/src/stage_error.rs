//! The error that ends a stage.

use flockslam_bus::{BusError, RuntimeError};
use std::path::PathBuf;

/// Why a stage had to stop.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The runtime directory failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The journal or a store failed.
    #[error(transparent)]
    Journal(#[from] flockslam_journal::JournalError),
    /// A file of the results failed.
    #[error(transparent)]
    Results(#[from] flockslam_results::ResultsError),
    /// Telemetry could not be set up.
    #[error("{0}")]
    Telemetry(String),
    /// A file of the set could not be read or written.
    #[error("{path}: {reason}")]
    File {
        /// Which file.
        path: PathBuf,
        /// What was wrong.
        reason: String,
    },
    /// The source of scans is not usable: a mistake of the user's, exit code 2.
    #[error("{0}")]
    Source(String),
    /// Messages do not reach this process, though they are in the journal.
    #[error(
        "{missed} poses are in the journal that did not arrive here: topics are opened anew by the next process"
    )]
    Unreached {
        /// Poses that were missed in one pause.
        missed: u64,
    },
}

impl StageError {
    /// A file problem.
    pub fn file(path: impl Into<PathBuf>, reason: impl std::fmt::Display) -> Self {
        Self::File { path: path.into(), reason: reason.to_string() }
    }
}
