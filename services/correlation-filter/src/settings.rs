use serde::{Deserialize, Serialize};

/// How scans are judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// By correlation with the kept scans.
    #[default]
    Correlation,
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
    /// A scan is dropped when its profile by angle correlates more than this with each scan of the window, −1 … 1.
    pub profile_threshold: f64,
    /// … and its histogram of ranges correlates more than this.
    pub histogram_threshold: f64,
    /// After so many drops in a row a scan is kept whatever it correlates with. This bounds how far the robot moves
    /// unseen: correlation hardly notices a move along the line of sight.
    pub consecutive_drops_max: u32,
    /// A scan with a greater share of corridor pattern (0 … 1) is kept: in a corridor all scans look the same.
    pub corridor_max: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            mode: Mode::Correlation,
            window: 4,
            profile_threshold: 0.8,
            histogram_threshold: 0.8,
            consecutive_drops_max: 2,
            corridor_max: 0.6,
        }
    }
}
