//! What the processes of a set log, changed while they run.

use super::ProcessSet;
use crate::supervisor::known_stage;
use flockslam_messages::Stage;
use flockslam_telemetry::{LogLevels, check_log_filter, set_log_filter};

/// Names the supervisor, and the whole set, where a stage is named.
const SUPERVISOR: &str = "supervisor";
const ALL: &str = "all";

impl ProcessSet {
    /// From now on a stage, the supervisor, or all of them log what `filter` lets through, also after a restart. An empty filter
    /// brings back what they began with.
    ///
    /// # Errors
    /// When the name or the filter is not known, or the levels cannot be stored: why.
    pub fn log(&self, name: &str, filter: &str) -> Result<(), String> {
        check_log_filter(filter).map_err(|problem| format!("'{filter}' selects nothing: {problem}"))?;
        if matches!(name, SUPERVISOR | ALL) {
            set_log_filter(filter)?;
        }
        let stages = match name {
            SUPERVISOR => Vec::new(),
            ALL => Stage::ALL.to_vec(),
            name => vec![known_stage(name).map_err(|problem| format!("{problem}, {SUPERVISOR}, {ALL}"))?],
        };
        let status_dir = self.runtime.status();
        stages.into_iter().try_for_each(|stage| {
            LogLevels::set(&status_dir, stage.name(), filter).map_err(|error| error.to_string())
        })
    }
}
