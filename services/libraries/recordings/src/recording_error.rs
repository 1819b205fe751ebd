//! Why a recording is not read: one line with place, reason and cure.

use crate::MessageProblem;
use std::io;

/// Why a recording is not read to its end.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file cannot be opened or read.
    #[error("{name}: {error}")]
    Unreadable {
        /// The file.
        name: String,
        /// The error of the system.
        error: io::Error,
    },
    /// It is none of the kinds that are known.
    #[error(
        "{name}: not a recording that can be read: ROS 1 bags, rosbag2 folders, .db3 and .mcap can be, packed with zstd or not"
    )]
    Unknown {
        /// The file or folder.
        name: String,
    },
    /// It is damaged.
    #[error("{name}: {place}: {problem}")]
    Damaged {
        /// The file.
        name: String,
        /// Where.
        place: String,
        /// What is wrong there.
        problem: String,
    },
    /// Messages do not match their types, more than are tolerated.
    #[error(
        "{name}: message {number} on {topic}: {problem}; with this {bad} of {number} are bad; record it again, or \
             raise lidar_ingest.max_bad_line_share"
    )]
    Message {
        /// The file.
        name: String,
        /// Number of the message among those that were read, from 1.
        number: u64,
        /// Its topic.
        topic: String,
        /// Those that were bad so far.
        bad: u64,
        /// The reason.
        problem: MessageProblem,
    },
}

impl RecordingError {
    pub(crate) fn damaged(name: &str, place: impl ToString, problem: impl ToString) -> Self {
        Self::Damaged { name: name.to_owned(), place: place.to_string(), problem: problem.to_string() }
    }

    pub(crate) fn unreadable(name: &str, error: io::Error) -> Self {
        Self::Unreadable { name: name.to_owned(), error }
    }
}
