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
    #[error("{name}: not a recording that can be read: ROS 1 bags, rosbag2 folders, .db3 and .mcap can be")]
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
    /// A message does not match its type.
    #[error("{name}: message {number} on {topic}: {problem}")]
    Message {
        /// The file.
        name: String,
        /// Number of the message among those that were read, from 1.
        number: u64,
        /// Its topic.
        topic: String,
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
