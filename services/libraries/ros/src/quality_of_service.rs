//! How topics are delivered.

use ros2_client::QosProfile;
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use std::time::Duration;

/// How the messages of a topic are delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QualityOfService {
    /// Best effort: what is lost is lost. A subscription receives from reliable and best-effort publishers.
    Sensor {
        /// Messages that may wait.
        depth: usize,
    },
    /// Each message arrives while both sides keep up.
    Reliable {
        /// Messages that may wait.
        depth: usize,
    },
    /// Reliable and transient local: late subscribers get the last messages.
    Latched {
        /// How many.
        depth: usize,
    },
}

impl QualityOfService {
    pub(crate) fn profile(self) -> QosProfile {
        // A reader that does not acknowledge must not hold the writer up for long.
        let reliable = Reliability::Reliable { when_full: WhenFull::Wait(Duration::from_millis(5)) };
        let (reliability, durability, depth) = match self {
            Self::Sensor { depth } => (Reliability::BestEffort, Durability::Volatile, depth),
            Self::Reliable { depth } => (reliable, Durability::Volatile, depth),
            Self::Latched { depth } => (reliable, Durability::TransientLocal, depth),
        };
        QosProfile::publisher_default()
            .reliability(reliability)
            .durability(durability)
            .history(History::KeepLast { depth })
    }
}
