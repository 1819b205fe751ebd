//! How topics are delivered.

use ros2_client::QosProfile;
use ros2_client::dds::rustdds::{QosPolicies, QosPolicyBuilder, policy::ResourceLimits};
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
    /// As `Latched` of one message, for messages of some megabytes: few of them wait for acknowledgements.
    Latest,
}

/// Latched messages that may wait for acknowledgements; further ones are refused. As many stay in memory, also while nobody subscribes:
/// RustDDS keeps what nobody has acknowledged, up to 8192 messages unless it has another limit.
const UNACKNOWLEDGED_MAX: usize = 1024;
/// The same for [`QualityOfService::Latest`]. A map is published every 5 s, and Fast DDS gives a subscriber up after 20 s of silence:
/// so many maps wait until one that has died no longer counts.
const LATEST_UNACKNOWLEDGED_MAX: usize = 5;

impl QualityOfService {
    /// Messages that may wait, or that late subscribers get.
    pub(crate) fn depth(self) -> usize {
        match self {
            Self::Sensor { depth } | Self::Reliable { depth } | Self::Latched { depth } => depth,
            Self::Latest => 1,
        }
    }

    /// Whether late subscribers get messages.
    pub(crate) fn is_latched(self) -> bool {
        matches!(self, Self::Latched { .. } | Self::Latest)
    }

    /// Whether each message arrives.
    pub(crate) fn is_reliable(self) -> bool {
        !matches!(self, Self::Sensor { .. })
    }

    pub(crate) fn profile(self) -> QosProfile {
        // A reader that does not acknowledge must not hold the writer up for long.
        let reliable = Reliability::Reliable { when_full: WhenFull::Wait(Duration::from_millis(5)) };
        let durability = if self.is_latched() { Durability::TransientLocal } else { Durability::Volatile };
        QosProfile::publisher_default()
            .reliability(if self.is_reliable() { reliable } else { Reliability::BestEffort })
            .durability(durability)
            .history(History::KeepLast { depth: self.depth() })
    }

    /// The policies of a topic that is published: the profile, and how much of it may be in memory.
    pub(crate) fn publisher_policies(self) -> QosPolicies {
        let profile = QosPolicies::from(self.profile());
        let max_samples = match self {
            Self::Latched { depth } => depth.max(UNACKNOWLEDGED_MAX),
            Self::Latest => LATEST_UNACKNOWLEDGED_MAX,
            // Of a topic that is not latched, what nobody acknowledges is dropped.
            Self::Sensor { .. } | Self::Reliable { .. } => return profile,
        } as i32;
        let limits = ResourceLimits { max_samples, max_instances: 1, max_samples_per_instance: max_samples };
        profile.modify_by(&QosPolicyBuilder::new().resource_limits(limits).build())
    }
}
