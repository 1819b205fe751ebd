//! Settings of the stage, section `[correlation_filter]` of the configuration.

use serde::{Deserialize, Serialize};

/// How scans are filtered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// By correlation with the kept scans.
    #[default]
    Correlation,
    /// As the published program does (An. Filatov 2021), its defects included.
    SeedExact,
    /// By odometry alone: a scan is dropped until it has moved far enough.
    Motion,
    /// Every scan with a valid range is kept.
    Off,
}

/// Settings of the filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// How scans are filtered.
    pub mode: Mode,
    /// Processes of this stage, each with its share of the beams of a large scan (more than 64 Ki beams).
    pub replicas: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { mode: Mode::Correlation, replicas: 1 }
    }
}
