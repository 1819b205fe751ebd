//! The map of a robot on disk: what a set continues, and what it saves while it runs.
//!
//! A saved map is a directory: `map.head` (who made it, with which layouts and settings), `scans.journal` (every pose, and each
//! accepted scan beside its pose) and `submaps/` (the closed ones). All of it is checksummed; the submaps follow from the journal,
//! so a damaged one is only made again. The journal is always ahead of the submaps, after a crash at any time.

mod head;
mod imported_map;
mod map_saver;
mod mirror;
mod nav2_map;
mod plan_views;
mod saved_map;
#[cfg(test)]
mod tests;

pub use head::{FORMAT, MapHead};
pub use imported_map::{Imported, import_map};
pub use map_saver::MapSaver;
pub use mirror::Mirror;
pub use nav2_map::{Nav2MapError, read_nav2_map};
pub use saved_map::{Findings, SavedMap};

use flockslam_journal::JournalError;
use flockslam_stage::StageError;
use std::path::PathBuf;

/// Why a saved map cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is no map in the directory.
    #[error("{0}: there is no saved map")]
    Absent(PathBuf),
    /// The head is damaged or foreign.
    #[error("{path}: {reason}")]
    Head {
        /// The head.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The map was made by a build or with settings that do not fit.
    #[error("{path}: the map was made with {key} = {found}, here it is {wanted}")]
    Mismatch {
        /// The map.
        path: PathBuf,
        /// What differs.
        key: &'static str,
        /// What the map has.
        found: String,
        /// What is needed.
        wanted: String,
    },
    /// The directory holds a map already.
    #[error("{0}: holds a saved map already; give another directory")]
    Taken(PathBuf),
    /// There is nothing in a map that a robot could see.
    #[error("the map shows no place from which a robot could see a wall")]
    Bare,
    /// The directory holds the map of something else.
    #[error("{0}: holds another map than the one that is to be saved there")]
    Other(PathBuf),
    /// The system refused.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// Message of the system.
        source: std::io::Error,
    },
    /// The journal failed.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The store of submaps failed.
    #[error(transparent)]
    Stage(#[from] StageError),
}

impl StoreError {
    fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }
}
