//! The message of the matcher about beams that end on moving objects.

use crate::message::message;
use crate::{ScanId, Times};

message! {
    /// Which beams of a matched scan lie on what moves, published before its pose; a scan without such beams has no message. A
    /// slice of [`BeamRange`], in order, follows.
    pub struct MovingBeamsHeader = "flockslam/moving-beams/v1" {
        /// The scan.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// Number of ranges that follow.
        pub count: u32,
        /// Reserved, zero.
        pub reserved: u32,
    }
}

message! {
    /// Beams beside each other.
    #[derive(Eq)]
    pub struct BeamRange = "flockslam/beam-range/v1" {
        /// The first.
        pub first: u32,
        /// The one behind the last.
        pub end: u32,
    }
}
