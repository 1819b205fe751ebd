//! Settings of the stage, section `[scan_matcher]` of the configuration.

use flockslam_registration::NdtSettings;
use serde::{Deserialize, Serialize};

/// Settings of the matcher.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// How a scan is fitted to the grid.
    pub strategy: Strategy,
    /// Settings of `ndt`; it needs the mapper's sensor model `evidence`.
    pub ndt: NdtSettings,
    /// What happens after a bad fit.
    pub rescue: Rescue,
    /// When a scan enters the map.
    pub gate: Gate,
    /// Whether the velocity during a scan whose beams leave one after the other is fitted together with its pose (`gauss-newton`,
    /// `correlative`, `ndt`); otherwise it is that of odometry before the scan.
    pub fits_velocity: bool,
    /// Shorter ranges are not matched, metres.
    pub range_min_m: f64,
    /// Longer ranges are not matched, metres.
    pub range_max_m: f64,
    /// Whether returns with nothing near beside them (dust, rain, false returns; never those within 2 m) are not matched.
    pub skip_isolated: bool,
    /// Beams that end where the grid knows free space, with nothing near, lie on what moves: they are set aside before a scan is
    /// fitted, unless they are more than this share of it, many lie on what is too wide to move, or the robot is lost; 0 = none ever is.
    /// What is as narrow as a person and stands free is left out of the fit as well, as long as enough else is seen.
    pub moving_share_max: f64,
    /// Processes of this stage: one matches, the others know what it knows and are on standby to go on in its place.
    pub replicas: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// How a scan is fitted to the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Strategy {
    /// Gauss–Newton on the interpolated score, from coarse to fine, with a correlative rescue.
    GaussNewton,
    /// vinySLAM's random search.
    MonteCarlo,
    /// Deterministic steps along each axis.
    HillClimbing,
    /// Best pose of a lattice around the prediction by branch and bound, then Gauss–Newton below a cell; with the rescue.
    Correlative,
    /// Points to normal distributions by Newton's method, with the rescue.
    Ndt,
}

/// What happens after a bad fit: a wide search (`gauss-newton`, `correlative`, `ndt`), and when a fit is not accepted at all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rescue {
    /// A score below this share of the running mean is a bad one: a wide search begins, the pose is degraded, and the next drop is
    /// overruled; 0 = none is, and odometry is used without a check.
    pub below: f64,
    /// After this many scans in a row that are not accepted the robot is taken to be somewhere else: the map is left as it is and
    /// a new trajectory begins, which a closure may attach; 0 = every fit is accepted.
    pub lost_scans_max: u32,
}

/// When a scan enters the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gate {
    /// A scan enters the map after this much travel since the last that did, metres; 0 = every scan.
    pub travel_m: f64,
    /// … or after this much turning, radians.
    pub turn_rad: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            strategy: Strategy::GaussNewton,
            ndt: NdtSettings::default(),
            rescue: Rescue::default(),
            gate: Gate::default(),
            fits_velocity: true,
            range_min_m: 0.4,
            range_max_m: 30.0,
            skip_isolated: true,
            moving_share_max: 0.6,
            replicas: 1,
            seed: 1,
        }
    }
}

impl Default for Rescue {
    fn default() -> Self {
        Self { below: 0.8, lost_scans_max: 10 }
    }
}

impl Default for Gate {
    fn default() -> Self {
        Self { travel_m: 0.2, turn_rad: 0.35 }
    }
}

impl Settings {
    /// Point-to-distribution matching from the odometry guess alone, every scan inserted (Trubin et al. 2020).
    pub fn ndt() -> Self {
        Self {
            strategy: Strategy::Ndt,
            // The map is updated with every scan, however well it fits.
            gate: Gate { travel_m: 0.0, turn_rad: 0.0 },
            rescue: Rescue { below: 0.0, lost_scans_max: 0 },
            fits_velocity: false,
            skip_isolated: false,
            moving_share_max: 0.0,
            // Along a corridor little but odometry says how far a move of metres went.
            ndt: NdtSettings {
                cell_size_m: 1.08,
                prior_travel: 40.0,
                // The published lidar: one degree.
                bearing_sigma_rad: 0.0175,
            },
            ..Self::default()
        }
    }

    /// What the program vinySLAM does, with hill climbing and odometry rotated into the corrected heading.
    pub fn vinyslam() -> Self {
        Self {
            strategy: Strategy::HillClimbing,
            gate: Gate { travel_m: 0.0, turn_rad: 0.0 },
            rescue: Rescue { lost_scans_max: 0, ..Rescue::default() },
            fits_velocity: false,
            range_min_m: 0.0,
            skip_isolated: false,
            moving_share_max: 0.0,
            ..Self::default()
        }
    }
}
