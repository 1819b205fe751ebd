//! The settings of sync-manager, with their defaults and rules.

use flockslam_flock_network::FlockSettings;
use serde::{Deserialize, Serialize};

/// Settings of the back end. The defaults are meant for any indoor robot with a 2-D lidar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Whether poses are optimised at all; otherwise the final trajectory is the front end's.
    pub enabled: bool,
    /// Whether loops are closed.
    pub close_loops: bool,
    /// A submap retires from the fused map when so many newer ones know all that it knows (98 % of it); 0 = never.
    pub retire_covered_by: usize,
    /// Whether cells that stand occupied in the finished map are cleared when at least three later scans, at their final poses, look
    /// through them.
    pub clear_at_end: bool,
    /// The robots that this one shares its map with.
    pub flock: FlockSettings,
    /// Processes of this stage: one speaks, the others know what it knows and are on standby to go on in its place.
    pub replicas: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            enabled: true,
            close_loops: true,
            retire_covered_by: 8,
            clear_at_end: true,
            flock: FlockSettings::default(),
            replicas: 1,
        }
    }
}
