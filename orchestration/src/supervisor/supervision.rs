//! Settings of the supervisor: whether the set is live, and what the processes of each stage may use.

use flockslam_messages::Stage;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// A stage of a run that was given up is tried again after this …
const RETRY_OF_RUN: Duration = Duration::from_secs(5);
/// … and so often, since the user waits for the results.
const RETRIES_OF_RUN: u32 = 12;

/// How a set is watched over.
#[derive(Clone, Debug, Default)]
pub struct Supervision {
    /// The set lives on its own: its state outlives the supervisor, and stages that hang are replaced. Otherwise the set is one run.
    pub live: bool,
    /// How often a stage that does not get up is tried again after it was given up; without end when `None`. Then the set ends.
    pub retries_max: Option<u32>,
    /// What each stage may use, by stage; the default where there is none.
    pub limits: BTreeMap<Stage, ProcessLimits>,
    /// A stage that was given up is tried again after this.
    pub retry: Duration,
}

impl Supervision {
    /// Of one run of a recorded or live source, from its start to its results: a stage that does not get up for good ends it.
    pub fn of_one_run() -> Self {
        Self { retries_max: Some(RETRIES_OF_RUN), retry: RETRY_OF_RUN, ..Self::default() }
    }

    /// What a stage may use.
    pub fn limits(&self, stage: Stage) -> ProcessLimits {
        self.limits.get(&stage).cloned().unwrap_or_default()
    }
}

/// What each process of a stage may use.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProcessLimits {
    /// Processes of the stage.
    pub replicas: Option<usize>,
    /// Processors that it may run on; all when empty.
    pub cpus: Vec<usize>,
    /// Memory of its own (not what is shared) that it may take, bytes.
    pub memory_max_bytes: Option<u64>,
    /// Niceness, -20 … 19: the higher, the more it yields to others. Below 0 only where the system allows it.
    pub nice: Option<i32>,
    /// Without a sign of life for so long it is taken to hang and is replaced, milliseconds.
    pub deadline_ms: Option<u64>,
}

/// Deadlines where nothing else is said. One call of sync-manager searches and solves for as long as it takes; all others come
/// round several times a second.
const DEADLINE: Duration = Duration::from_millis(500);
const DEADLINE_OF_SYNC_MANAGER: Duration = Duration::from_secs(60);

impl ProcessLimits {
    /// How long a process of this stage may be silent.
    pub fn deadline(&self, stage: Stage) -> Duration {
        let usual = if stage == Stage::SyncManager { DEADLINE_OF_SYNC_MANAGER } else { DEADLINE };
        self.deadline_ms.map_or(usual, Duration::from_millis)
    }
}
