//! Messages of the dynamic cleaner: cleared cells of the map, and the findings of a replica in its sector.

use crate::message::message;
use crate::{ScanId, Times};

message! {
    /// Marks of the dynamic cleaner for an inserted scan. A slice of [`ClearedCell`] follows.
    pub struct MarksHeader = "flockslam/marks/v1" {
        /// The scan.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// Grid generation that was read.
        pub generation: u64,
        /// Beams classified as moving objects.
        pub moving_beams: u32,
        /// Number of cleared cells that follow.
        pub cleared: u32,
    }
}

message! {
    /// A cell (index in the odom lattice) whose evidence for "occupied" is stale.
    #[derive(Eq, PartialOrd, Ord)]
    pub struct ClearedCell = "flockslam/cleared-cell/v1" {
        /// Column of cells.
        pub x: i32,
        /// Row of cells.
        pub y: i32,
    }
}

message! {
    /// Judgements of one replica of the dynamic cleaner in its sector of the circle around the lidar. A slice of [`JudgedCell`] follows.
    pub struct SectorHeader = "flockslam/sector/v1" {
        /// The scan.
        pub id: ScanId,
        /// Grid generation that was read.
        pub generation: u64,
        /// Which sector, from 0.
        pub part: u32,
        /// Number of sectors.
        pub parts: u32,
    }
}

message! {
    /// An occupied cell (index in the odom lattice) that a scan classifies.
    #[derive(Eq)]
    pub struct JudgedCell = "flockslam/judged-cell/v1" {
        /// Column of cells.
        pub x: i32,
        /// Row of cells.
        pub y: i32,
        /// Its place among all occupied cells in reach: those of several sectors are put into this order.
        pub place: u32,
        /// 1: beams pass through it; 0: a beam ends at it.
        pub seen_through: u32,
    }
}
