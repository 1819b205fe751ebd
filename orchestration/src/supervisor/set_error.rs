//! Errors of a process set.

use flockslam_bus::{BusError, RuntimeError, TooSmall};
use flockslam_stage::StageError;
use std::io;
use std::time::Duration;

/// A stage that takes longer than this to get ready is not waited for. A small computer needs a minute for a known map of 40 000 m².
pub(super) const READY_LIMIT: Duration = Duration::from_secs(120);

/// Why a process set failed.
#[derive(Debug, thiserror::Error)]
pub enum SetError {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The runtime directory failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// A file of the set failed.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// The set does not fit into shared memory.
    #[error(transparent)]
    TooSmall(#[from] TooSmall),
    /// The system lets a process open too few files.
    #[error(
        "a process of this set needs {needed} open files, the system allows {allowed}: raise the hard limit (ulimit -n {needed}, \
         LimitNOFILE={needed} of a service, --ulimit nofile={needed} of a container)"
    )]
    OpenFiles {
        /// What is needed.
        needed: u64,
        /// The limit.
        allowed: u64,
    },
    /// A process could not be started or watched.
    #[error("cannot start {stage}: {source}")]
    Start {
        /// Which stage.
        stage: &'static str,
        /// Message of the system.
        source: io::Error,
    },
    /// A stage did not get ready.
    #[error("{0} was not ready within {limit} s", limit = READY_LIMIT.as_secs())]
    NotReady(&'static str),
    /// The source of scans is not usable.
    #[error("{0}")]
    Source(String),
    /// A stage ended in exact replay, which has no restarts.
    #[error("{stage} ended during an exact replay ({how}): run it again, or replay live with --rate")]
    Ended {
        /// Which stage.
        stage: &'static str,
        /// Its exit status.
        how: String,
    },
    /// A stage ends again and again.
    #[error("{stage} died {times} times in a row soon after its start ({how})")]
    GivenUp {
        /// Which stage.
        stage: &'static str,
        /// Starts in a row that ended before it had worked.
        times: u32,
        /// Its last exit status.
        how: String,
    },
}
