//! The errors of the bus.

use crate::room::{Megabytes, Room, take_refused_bytes};

/// Errors of the bus. Every variant names the topic or place and the reason.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The set's shared memory could not be prepared.
    #[error("cannot prepare shared memory in {place}: {reason}")]
    Setup {
        /// Directory or object.
        place: String,
        /// The error of the system.
        reason: String,
    },
    /// A topic could not be created or opened.
    #[error("cannot open topic {topic}: {reason}")]
    Open {
        /// Name of the topic.
        topic: String,
        /// The error of iceoryx2.
        reason: String,
    },
    /// Shared memory is used up.
    #[error(
        "no room in shared memory for {what}: {} more are needed; {room}: make room there, or give more (--shm-size of a container)",
        Megabytes(*bytes)
    )]
    NoRoom {
        /// Topic, event or node.
        what: String,
        /// Size of what was to be made, bytes.
        bytes: u64,
        /// What there is.
        room: Room,
    },
    /// The process that created the topic was built with another layout of its message.
    #[error(
        "topic {topic} was created by another build of flockslam (message {message}, layout {layout:016x} here): \
         stop the set and start all of its processes from one executable"
    )]
    Disagree {
        /// Name of the topic.
        topic: String,
        /// Type name and version in this build.
        message: &'static str,
        /// Layout fingerprint in this build.
        layout: u64,
    },
    /// A message could not be sent or received.
    #[error("topic {topic}: {reason}")]
    Transfer {
        /// Name of the topic.
        topic: &'static str,
        /// The error of iceoryx2.
        reason: String,
    },
}

impl BusError {
    pub(crate) fn transfer(topic: &'static str, reason: impl std::fmt::Debug) -> Self {
        Self::no_room(topic).unwrap_or_else(|| Self::Transfer { topic, reason: format!("{reason:?}") })
    }

    pub(crate) fn open(topic: &str, reason: impl std::fmt::Debug) -> Self {
        Self::no_room(topic)
            .unwrap_or_else(|| Self::Open { topic: topic.to_owned(), reason: format!("{reason:?}") })
    }

    /// When this thread was refused memory just now.
    pub(crate) fn no_room(what: &str) -> Option<Self> {
        take_refused_bytes().map(|bytes| Self::out_of_room(what, bytes))
    }

    pub(crate) fn out_of_room(what: &str, bytes: u64) -> Self {
        let room = Room::now().unwrap_or(Room { total_bytes: 0, free_bytes: 0 });
        Self::NoRoom { what: what.to_owned(), bytes, room }
    }
}
