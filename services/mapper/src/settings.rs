//! Settings of the stage, section `[mapper]` of the configuration: sensor model, read-out, submaps and window.

use flockslam_evidence::{Cell, Masses};
use flockslam_ray_insertion::SensorModel;
use serde::{Deserialize, Serialize};

/// Weight of evidence of a hit, nat: five misses take one hit back.
pub(crate) const HIT_NAT: f64 = 1.5;
/// A submap is closed after this much travel, metres: short enough that drift within it does not show.
pub(crate) const SUBMAP_LENGTH_M: f64 = 5.0;

/// Settings of the mapper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Which evidence a beam leaves, and which score of it the matcher reads.
    pub sensor_model: SensorModelKind,
    /// Weight of evidence of a miss, nat (`evidence` model).
    pub miss_nat: f64,
    /// Shorter ranges are not inserted, metres.
    pub range_min_m: f64,
    /// Whether returns with nothing near beside them (dust, rain, false returns; never those within 2 m) are not inserted.
    pub skip_isolated: bool,
    /// What stands where the map knows free space enters it once so many scans, at least 0.3 s apart, have seen it there: who
    /// walks by leaves no trail. 1 = at once.
    pub confirming_scans: u8,
    /// A submap is closed after 5 m of travel or this many insertions, which keeps its sums far from saturation.
    pub submap_insertions: u32,
    /// Travel that the closed submaps beside the active one cover in the grid that is matched, metres (rounded up to
    /// whole submaps of 5 m); 0 = all of them.
    pub window_m: f64,
    /// Processes of this stage: each inserts every scan and publishes its share of the tiles.
    pub replicas: usize,
}

/// Which evidence a beam leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SensorModelKind {
    /// 1.5 nat for "occupied" at the end, `miss_nat` for "free" on the way; read is the mass on "occupied".
    Evidence,
    /// vinySLAM's masses, blur and score.
    Vinyslam,
}

/// Score of a cell that the matcher reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadOut {
    /// The mass on "occupied"; unknown and free alike are 0, so that no edge of knowledge pulls.
    Occupied,
    /// vinySLAM's score: occupied 1, unknown ½, free 0.
    Vinyslam,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            cell_size_m: 0.045,
            sensor_model: SensorModelKind::Evidence,
            miss_nat: 0.3,
            range_min_m: 0.4,
            skip_isolated: true,
            confirming_scans: 3,
            submap_insertions: 200,
            window_m: 30.0,
            replicas: 1,
        }
    }
}

impl Settings {
    /// What the program vinySLAM does: cells of 0.1 m, its masses, blur and score, one map for all.
    pub fn vinyslam() -> Self {
        Self {
            cell_size_m: 0.1,
            sensor_model: SensorModelKind::Vinyslam,
            range_min_m: 0.0,
            skip_isolated: false,
            confirming_scans: 1,
            submap_insertions: 2000,
            window_m: 0.0,
            ..Self::default()
        }
    }

    /// Points in cells: one map for all scans, in which the cells of a point-to-distribution matcher hold at most 256 points, one
    /// for each cell of the grid. A beam that passes tells free cells from unknown ones, but never outweighs a point.
    pub fn ndt() -> Self {
        Self {
            cell_size_m: 0.0225,
            miss_nat: 0.001,
            skip_isolated: false,
            confirming_scans: 1,
            submap_insertions: 2000,
            window_m: 0.0,
            ..Self::default()
        }
    }

    /// Closed submaps in the grid that is matched; `None` = all.
    pub(crate) fn window_submaps(&self) -> Option<usize> {
        (self.window_m > 0.0).then(|| (self.window_m / SUBMAP_LENGTH_M).ceil() as usize)
    }

    /// Score that the matcher reads: that of the sensor model.
    pub fn read_out(&self) -> ReadOut {
        match self.sensor_model {
            SensorModelKind::Evidence => ReadOut::Occupied,
            SensorModelKind::Vinyslam => ReadOut::Vinyslam,
        }
    }

    /// The inverse sensor model that the settings name.
    pub fn model(&self) -> SensorModel {
        match self.sensor_model {
            SensorModelKind::Evidence => {
                SensorModel::new(Cell::from_weights(HIT_NAT, 0.0), Cell::from_weights(0.0, self.miss_nat))
            }
            SensorModelKind::Vinyslam => SensorModel::vinyslam(0.9),
        }
    }
}

impl ReadOut {
    /// Evidence for "occupied" and for "free" counts at most this much in the score, nat.
    pub(crate) fn caps_nat(self) -> (f64, f64) {
        match self {
            Self::Occupied => (20.0, 5.0),
            Self::Vinyslam => (16.0, 16.0),
        }
    }

    /// Score of a cell without evidence, 0 … 65535.
    pub fn unknown(self) -> u16 {
        self.score(Masses::UNKNOWN)
    }

    /// Score of a cell, 0 … 65535.
    pub fn score(self, masses: Masses) -> u16 {
        let score = match self {
            Self::Occupied => masses.occupied,
            Self::Vinyslam => masses.vinyslam_score(),
        };
        (score * f64::from(u16::MAX)).round() as u16
    }
}
