//! The message of a stage about what it has used for a scan: a recording of it can be run again as it was.

use crate::message::message;
use crate::{CommitName, Correction, ScanId};

message! {
    /// What scan-matcher or dynamic-cleaner had in hand when it handled a scan. Nobody waits for it.
    pub struct StageInputs = "flockslam/stage-inputs/v3" {
        /// The scan.
        pub id: ScanId,
        /// The process: CLOCK_MONOTONIC when it began, nanoseconds.
        pub process: u64,
        /// Counts the scans that the process has handled from 1.
        pub handled: u64,
        /// Sequence of the scan after whose pose the process went on; meaningful unless it began with nothing.
        pub resumed_after: u64,
        /// The commit of the grid.
        pub grid: CommitName,
        /// The first commit that the process has taken in: tiles of earlier ones it has only by later ones.
        pub first_grid: CommitName,
        /// The current correction; revision 0 when there is none.
        pub correction: Correction,
        /// Tiles of the grid.
        pub tiles: u32,
        /// Which stage.
        pub stage: u32,
        /// How the process began, a [`StageStart`] as number.
        pub start: u32,
        /// scan-matcher: 1 when the filter's result was to process the scan.
        pub keep: u32,
        /// scan-matcher: reason of the verdict.
        pub reason: u32,
        /// scan-matcher: other robots whose poses were known.
        pub flock_robots: u32,
        /// dynamic-cleaner: 1 when it had the scan.
        pub has_scan: u32,
        /// dynamic-cleaner: 1 when the grid that the pose was found in was there.
        pub has_grid: u32,
    }
}

/// What a process of a stage began with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum StageStart {
    /// Nothing.
    Anew = 0,
    /// The last pose of its predecessor.
    Resumed = 1,
    /// The last pose of a saved map.
    Continued = 2,
}
