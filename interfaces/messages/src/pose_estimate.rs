//! The message of the matcher about the pose of a scan: pose, covariance, velocity, quality and flags.

use crate::message::message;
use crate::{ScanId, Times};
use flockslam_geometry::{Covariance, Pose, Twist};

message! {
    /// Where the robot was at a scan, published for every scan.
    pub struct PoseEstimate = "flockslam/pose/v2" {
        /// The scan.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// Continuous pose of the front end: it never jumps at a loop closure.
        pub odom_from_base: Pose,
        /// The latest correction; `map_from_base = map_from_odom ∘ odom_from_base`.
        pub map_from_odom: Pose,
        /// Odometry (dead reckoning) at the scan (identity when there is none), for interpolation afterwards.
        pub odometry: Pose,
        /// Covariance of `odom_from_base` against the grid that was matched.
        pub covariance: Covariance,
        /// The robot's own velocity while the scan was taken, in `base_link`: what takes its motion out of the scan.
        pub twist: Twist,
        /// Grid generation that was read.
        pub generation: u64,
        /// Mean matching score, 0 … 1; 0 when not matched.
        pub score: f64,
        /// Number of the submap that a scan inserted now enters.
        pub submap: u32,
        /// Number of corrections received so far.
        pub corrections: u32,
        /// A [`Quality`] as number.
        pub quality: u32,
        /// Bits of [`PoseFlags`].
        pub flags: u32,
        /// Why the filter dropped the scan (a `DropReason` as number), 0 when it was kept.
        pub drop_reason: u32,
        /// Number of the trajectory, from 0. A robot that stays lost begins a new one: its pose relative to those before is
        /// known from closures, and from odometry where nothing contradicts it ([`PoseFlags::CONTINUES`]).
        pub trajectory: u32,
    }
}

impl PoseEstimate {
    /// Pose of the robot in the `map` frame.
    pub fn map_from_base(&self) -> Pose {
        self.map_from_odom * self.odom_from_base
    }

    /// Whether all of `bits` are set.
    pub fn has(&self, bits: u32) -> bool {
        self.flags & bits == bits
    }
}

/// How far a pose can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Quality {
    /// The scan fits the grid.
    Tracking = 0,
    /// Along one direction only the prediction is known (a corridor), or the scan fits badly.
    Degraded = 1,
    /// The scan does not fit the grid.
    Lost = 2,
}

/// Bits of [`PoseEstimate::flags`].
pub struct PoseFlags;

impl PoseFlags {
    /// The scan was matched to the grid (otherwise the pose is a prediction).
    pub const MATCHED: u32 = 1;
    /// The scan is accepted: its evidence enters the map.
    pub const INSERT: u32 = 2;
    /// The matcher processed the scan although the filter dropped it.
    pub const OVERRIDDEN: u32 = 4;
    /// A wide search was needed.
    pub const RESCUED: u32 = 8;
    /// The scan had wheel odometry.
    pub const HAS_ODOMETRY: u32 = 16;
    /// The scan begins a trajectory after the robot was lost, and nothing contradicts odometry: its pose is the start of the trajectory
    /// relative to the one before.
    pub const CONTINUES: u32 = 32;
    /// The grid does not hold the scan: its pose follows from the surfaces that the last scans have shown, and from the prediction.
    pub const OPEN: u32 = 64;
    /// The set localizes in a known map and is not localized there: `map_from_odom` is not valid.
    pub const UNPLACED: u32 = 128;
    /// The set localizes: the scan is no part of the map.
    pub const LOCALIZING: u32 = 256;
    /// The scan was not taken: it is what a lidar would see at this pose of an imported map. The pose is given, and stays.
    pub const IMPORTED: u32 = 512;
}
