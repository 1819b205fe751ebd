//! Messages of the mapper: changed tiles, the commit that makes them valid, a closed submap.

use crate::message::message;
use crate::{ScanId, Times};
use flockslam_evidence::{Tile, TileKey};
use flockslam_geometry::Pose;

message! {
    /// One changed tile of the active grid. It becomes valid with the commit of its generation.
    pub struct TileMessage = "flockslam/tile/v1" {
        /// Which tile, in the odom lattice.
        pub key: TileKey,
        /// Generation of the grid that it belongs to.
        pub generation: u64,
        /// Side of a cell, metres.
        pub cell_size_m: f64,
        /// 1 when the tile left the active grid: readers drop it.
        pub retired: u32,
        /// Reserved, zero.
        pub reserved: u32,
        /// Evidence and score.
        pub tile: Tile,
    }
}

message! {
    /// Names a commit for good: generations come again after a restart of the mapper.
    #[derive(Eq, Hash)]
    pub struct CommitName = "flockslam/commit-name/v1" {
        /// The process of the mapper: CLOCK_MONOTONIC when it began, nanoseconds. 0 names no commit.
        pub mapper: u64,
        /// Counts the commits of this process from 1.
        pub number: u64,
    }
}

message! {
    /// Makes all tiles up to a generation valid: readers switch at this and at nothing else.
    pub struct Commit = "flockslam/commit/v2" {
        /// The scan that was inserted last.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// Its own name.
        pub name: CommitName,
        /// The generation that is now valid.
        pub generation: u64,
        /// Tiles published for this generation.
        pub tiles: u32,
        /// Submap that the next inserted scan enters.
        pub active_submap: u32,
        /// Cells that the cleaner's marks have cleared before the insertion.
        pub cleared: u32,
        /// Closed submaps that the process began with.
        pub resumed_submaps: u32,
        /// 1 when nothing was inserted, and all tiles were published once more.
        pub all_tiles: u32,
        /// Reserved, zero.
        pub reserved: u32,
    }
}

message! {
    /// One of several mappers has inserted a scan into its tiles and sent them: the commit of all follows when every one has.
    #[derive(Eq)]
    pub struct PartInserted = "flockslam/part-inserted/v1" {
        /// The scan.
        pub id: ScanId,
        /// Tiles published for it.
        pub tiles: u32,
        /// Which share of the tiles, from 0.
        pub part: u32,
        /// Number of shares.
        pub parts: u32,
        /// 1 when all tiles of the share were published once more.
        pub all_tiles: u32,
    }
}

message! {
    /// A submap was closed and stored; its file is in the store of the set.
    pub struct SubmapClosed = "flockslam/submap-closed/v1" {
        /// First scan in it.
        pub first: ScanId,
        /// Last scan in it.
        pub last: ScanId,
        /// `odom_from_base` of the first scan: the submap's reference pose.
        pub odom_from_submap: Pose,
        /// FNV-1a hash of the stored content.
        pub checksum: u64,
        /// Its number within the run, from 0.
        pub number: u32,
        /// Scans inserted.
        pub insertions: u32,
    }
}
