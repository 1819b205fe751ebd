//! Settings of the stage, section `[dynamic_cleaner]` of the configuration.

use serde::{Deserialize, Serialize};

/// Settings of the cleaner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// False: nothing is ever cleared.
    pub enabled: bool,
    /// How a beam that passes through a cell is detected.
    pub method: Method,
    /// Only cells within this distance of the lidar are classified, metres: points thin out with range.
    pub radius_m: f64,
    /// So many scans must have looked through a cell, from places 0.15 m or 0.3 rad apart, before it is cleared; scans of a robot that
    /// stands count up to the last vote but one when they are 0.3 s apart.
    pub votes: u8,
    /// Processes of this stage, each of which classifies the cells in its sector of the circle around the lidar.
    pub replicas: usize,
}

/// How a beam that passes through a cell is detected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Beam by beam, with margins for the errors of range and pose and for what is beside.
    Beams,
    /// By segments in angular sectors, without margins (Trubin et al. 2020).
    Sectors,
}

impl Method {
    /// A scan that looks through more than this share of the cells that it can classify votes for nothing: then the pose or the grid is
    /// wrong, not the world. The published method has no such limit.
    pub(crate) fn contradiction_max(self) -> f64 {
        match self {
            Self::Beams => 0.2,
            Self::Sectors => 1.0,
        }
    }

    /// Cells cleared by one scan at most; the rest follow with the next ones.
    pub(crate) fn cleared_max(self) -> usize {
        match self {
            Self::Beams => 4096,
            Self::Sectors => 1 << 14,
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self { enabled: true, method: Method::Beams, radius_m: 12.0, votes: 3, replicas: 1 }
    }
}

impl Settings {
    /// The published map update by ray tracing in sectors: what one scan looks through within 4 m is removed at once.
    pub fn sectors() -> Self {
        Self { method: Method::Sectors, radius_m: 4.0, votes: 1, ..Self::default() }
    }
}
