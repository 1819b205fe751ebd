use crate::message::message;
use crate::{ScanId, Times};

message! {
    /// What the dynamic cleaner says of an inserted scan. A slice of [`ClearedCell`] follows.
    pub struct MarksHeader = "flockslam/marks/v1" {
        /// The scan.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// Grid generation that was read.
        pub generation: u64,
        /// Beams judged to lie on moving objects.
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
