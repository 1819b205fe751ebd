//! What the bridge keeps over its own death: the state of the node, in a file of the set.

use super::bond::HEARTBEAT_TIMEOUT;
use super::lifecycle::NodeState;
use flockslam_journal::{Durability, replace_file};
use flockslam_telemetry::monotonic_ns;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The state of the node as it was last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptState {
    /// The state.
    pub state: NodeState,
    /// Of the bond.
    pub instance: String,
    /// When it was so, on the monotonic clock, nanoseconds.
    kept_ns: u64,
    #[serde(skip)]
    file: PathBuf,
}

impl KeptState {
    /// The state that a successor in the set with this status directory takes up: the one that its predecessor had less than a bond's
    /// timeout ago, else `fresh`.
    pub fn open(status_dir: &Path, fresh: NodeState) -> Self {
        let file = status_dir.join("ros-node");
        let now_ns = monotonic_ns();
        let read = std::fs::read(&file).ok().and_then(|json| serde_json::from_slice::<Self>(&json).ok());
        let is_recent =
            |kept: &Self| now_ns.saturating_sub(kept.kept_ns) < HEARTBEAT_TIMEOUT.as_nanos() as u64;
        let instance = || format!("{now_ns:x}-{:x}", std::process::id());
        match read.filter(is_recent) {
            Some(kept) => Self { file, ..kept },
            None => Self { state: fresh, instance: instance(), kept_ns: now_ns, file },
        }
    }

    /// Keeps a state. What cannot be written is lost with this process.
    pub fn keep(&mut self, state: NodeState) {
        (self.state, self.kept_ns) = (state, monotonic_ns());
        let json = serde_json::to_vec(self).expect("plain fields can be written");
        if let Err(error) = replace_file(&self.file, &json, Durability::Process) {
            tracing::debug!(%error, "the state of the node is not kept");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_successor_goes_on_where_its_predecessor_was_a_moment_ago() {
        let directory = tempfile::tempdir().unwrap();
        let mut first = KeptState::open(directory.path(), NodeState::Unconfigured);
        assert_eq!(first.state, NodeState::Unconfigured);
        first.keep(NodeState::Active);
        let second = KeptState::open(directory.path(), NodeState::Unconfigured);
        assert_eq!((second.state, &second.instance), (NodeState::Active, &first.instance));
        let mut old = first.clone();
        old.kept_ns -= HEARTBEAT_TIMEOUT.as_nanos() as u64;
        std::fs::write(&old.file, serde_json::to_vec(&old).unwrap()).unwrap();
        let late = KeptState::open(directory.path(), NodeState::Unconfigured);
        assert_eq!(late.state, NodeState::Unconfigured);
        std::fs::write(&old.file, b"{").unwrap();
        assert_eq!(KeptState::open(directory.path(), NodeState::Inactive).state, NodeState::Inactive);
    }
}
