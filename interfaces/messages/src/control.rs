//! Messages about the stream of scans as a whole: its end, and requests to stages.

use crate::message::message;

message! {
    /// An event of the stream of scans as a whole.
    #[derive(Eq)]
    pub struct Control = "flockslam/control/v1" {
        /// A [`ControlKind`] as number.
        pub kind: u32,
        /// Cold start that it belongs to.
        pub run: u32,
        /// `StreamEnd`: number of scans published in the run.
        pub value: u64,
    }
}

/// Kinds of [`Control`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ControlKind {
    /// The source has ended; `value` scans were published.
    StreamEnd = 1,
    /// sync-manager has stored its final solution and map.
    Finished = 2,
    /// The source is asked to end: what it has sent is the whole stream.
    EndWanted = 5,
    /// The mapper has closed its last submap; `value` submaps there are.
    MapClosed = 4,
    /// A restarted reader requests all live tiles from the mapper.
    TilesWanted = 3,
}
