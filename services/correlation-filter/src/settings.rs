//! Settings of the stage, section `[correlation_filter]` of the configuration.

use serde::{Deserialize, Serialize};

/// How scans are judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// By correlation with the kept scans.
    #[default]
    Correlation,
    /// As the published program does (An. Filatov 2021), its defects included; the other settings do not count.
    SeedExact,
    /// By the wheels alone: a scan is dropped until they have moved far enough.
    Motion,
    /// Every scan with a valid range is kept.
    Off,
}

/// What the filter can be told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// How scans are judged.
    pub mode: Mode,
    /// Kept scans to compare with; nothing is dropped before there are so many. Fewer and fuller: more is dropped.
    pub window: usize,
    /// A scan is dropped when its profile by angle, turned by the wheels' heading, correlates more than this with that of each
    /// scan of the window, −1 … 1.
    pub profile_threshold: f64,
    /// … and its histogram of ranges correlates more than this.
    pub histogram_threshold: f64,
    /// After so many drops in a row a scan is kept whatever it correlates with. This bounds how long the robot moves unseen.
    pub consecutive_drops_max: u32,
    /// A scan is kept when the wheels have moved farther than this since the last kept one, metres …
    pub unseen_travel_m: f64,
    /// … or turned more than this, radians.
    pub unseen_turn_rad: f64,
    /// The same bound as `consecutive_drops_max` while nothing changes: the robot stands still.
    pub rest_drops_max: u32,
    /// A scan with a greater share of corridor pattern (0 … 1) is kept: in a corridor all scans look the same.
    pub corridor_max: f64,
    /// Live: scans that the matcher may be behind before every scan is dropped but one in four, until it has caught up.
    pub shed_behind_scans: u64,
    /// Threads of each process that describe a large scan; it takes one for each 100 thousand beams at most.
    pub threads: usize,
    /// Processes of this stage, each with its share of the beams of a large scan (more than 64 Ki beams).
    pub replicas: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            mode: Mode::Correlation,
            window: 3,
            profile_threshold: 0.6,
            histogram_threshold: 0.5,
            consecutive_drops_max: 2,
            unseen_travel_m: 0.12,
            unseen_turn_rad: 0.15,
            rest_drops_max: 40,
            corridor_max: 0.6,
            shed_behind_scans: 16,
            threads: 2,
            replicas: 1,
        }
    }
}
