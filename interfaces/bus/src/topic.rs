//! The topics: name, element and limits of each, as functions of the capacity of a set.

use crate::tile_port::LANES;
use flockslam_messages::{
    BeamRange, ClearedCell, Commit, Control, Correction, FlockFrame, FlockRobots, JudgedCell, Layout,
    LocalisationOrder, MarksHeader, Message, MovingBeamsHeader, PartInserted, PoseEstimate, Progress,
    ScanHeader, ScanTally, SectorHeader, StageInputs, SubmapClosed, TileMessage, Track, TracksHeader,
    Verdict,
};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The sizes of a set, fixed when it is started: the creator of a service fixes its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capacity {
    /// Scans that may be on their way at once: the credit of exact replay and the queue length of every reader.
    pub window: usize,
    /// Greatest number of replicas of a stage (one more is reserved for a successor of a dying one).
    pub replicas: usize,
    /// Greatest number of live tiles of the active grid.
    pub live_tiles: usize,
}

impl Default for Capacity {
    fn default() -> Self {
        Self { window: 64, replicas: 2, live_tiles: 4096 }
    }
}

/// Limits of one topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Publishers at once; a sender of tiles has several.
    pub publishers: usize,
    /// Subscribers at once.
    pub subscribers: usize,
    /// Messages that wait for a reader before the oldest is replaced.
    pub buffer: usize,
    /// Messages that a reader may hold.
    pub borrowed: usize,
    /// Messages that a publisher keeps memory for; everything a reader could hold when `None`.
    pub preallocated: Option<usize>,
    /// Messages whose memory is taken when a publisher is made; all when `None`. That of the others is taken when they are first used.
    pub reserved: Option<usize>,
}

/// Live tiles for which memory is taken at the start, twice: a changed one is sent while the former is read. More than the largest
/// of the public logs needs.
const RESERVED_TILES: usize = 160;

/// Processes that may read a topic: the stages with their replicas, the supervisor, viewers, recorders.
const READERS: usize = 20;

/// Those that read scans at once: two processes of each stage, page, recorder and ROS bridge.
const SCAN_READERS: usize = 15;

impl Limits {
    fn small(capacity: &Capacity) -> Self {
        Self {
            publishers: capacity.replicas + 1,
            subscribers: READERS,
            buffer: 2 * capacity.window,
            borrowed: 4,
            preallocated: None,
            reserved: None,
        }
    }
}

/// A message with a topic of its own.
pub trait Topic: Message + core::fmt::Debug {
    /// Name on the bus.
    const NAME: &'static str;

    /// Its limits in a set of this capacity.
    fn limits(capacity: &Capacity) -> Limits {
        Limits::small(capacity)
    }
}

/// A header with a slice of elements behind it.
pub trait SliceTopic: Message + core::fmt::Debug {
    /// Type of the elements of the slice.
    type Element: Message + core::fmt::Debug;
    /// Name on the bus.
    const NAME: &'static str;
    /// Elements for which memory is laid out at first; longer slices make it grow.
    const FIRST_LENGTH: usize;

    /// Its limits in a set of this capacity.
    fn limits(capacity: &Capacity) -> Limits;
}

impl Topic for Verdict {
    const NAME: &'static str = "verdict";
}
impl Topic for ScanTally {
    const NAME: &'static str = "scan-tally";
}
impl Topic for PoseEstimate {
    const NAME: &'static str = "pose";
}
impl Topic for Commit {
    const NAME: &'static str = "commit";
}
impl Topic for StageInputs {
    const NAME: &'static str = "stage-inputs";

    fn limits(capacity: &Capacity) -> Limits {
        // Two stages publish on it; only recorders read it.
        Limits { publishers: 2 * (capacity.replicas + 1), ..Limits::small(capacity) }
    }
}
impl Topic for SubmapClosed {
    const NAME: &'static str = "submap-closed";
}
impl Topic for PartInserted {
    const NAME: &'static str = "part-inserted";
}
impl Topic for Correction {
    const NAME: &'static str = "correction";
}
impl Topic for LocalisationOrder {
    const NAME: &'static str = "localisation-order";
}
impl Topic for FlockFrame {
    const NAME: &'static str = "flock-frame";
}
impl Topic for FlockRobots {
    const NAME: &'static str = "flock-robots";

    fn limits(capacity: &Capacity) -> Limits {
        // Only the newest counts.
        Limits { buffer: 4, borrowed: 2, preallocated: Some(32), ..Limits::small(capacity) }
    }
}
impl Topic for Control {
    const NAME: &'static str = "control";

    fn limits(capacity: &Capacity) -> Limits {
        // All stages, the supervisor and viewers publish on it; viewers keep their port.
        Limits { publishers: 6 * (capacity.replicas + 1) + 8, ..Limits::small(capacity) }
    }
}
impl Topic for Progress {
    const NAME: &'static str = "progress";

    fn limits(capacity: &Capacity) -> Limits {
        Limits { publishers: 5 * (capacity.replicas + 1), ..Limits::small(capacity) }
    }
}
impl Topic for TileMessage {
    const NAME: &'static str = "tile";

    fn limits(capacity: &Capacity) -> Limits {
        // Each lane carries its share of the tiles, twice that when they lie along a diagonal.
        let (lane, buffer) = (2 * capacity.live_tiles.div_ceil(LANES), 128);
        Limits {
            publishers: LANES * (capacity.replicas + 1),
            buffer,
            borrowed: lane + buffer,
            // Readers hold the newest sample of each tile, so memory for all live ones and two rounds of changes is enough, and a
            // third for a viewer that was stopped with a full queue.
            preallocated: Some(lane + 3 * buffer),
            reserved: Some(2 * capacity.live_tiles.min(RESERVED_TILES).div_ceil(LANES)),
            ..Limits::small(capacity)
        }
    }
}

impl SliceTopic for ScanHeader {
    type Element = f32;
    const NAME: &'static str = "scan";
    const FIRST_LENGTH: usize = 1024;

    fn limits(capacity: &Capacity) -> Limits {
        Limits {
            buffer: capacity.window,
            borrowed: capacity.window + 2,
            // The queues of all readers have the same scans; what they hold may differ where they lag differently. When memory for
            // a message is missing, iceoryx2 0.10 adds some that it then cannot count, and panics.
            preallocated: Some(capacity.window + SCAN_READERS * (capacity.window + 2) + 3),
            reserved: Some(4 * capacity.window),
            ..Limits::small(capacity)
        }
    }
}

impl SliceTopic for MarksHeader {
    type Element = ClearedCell;
    const NAME: &'static str = "marks";
    const FIRST_LENGTH: usize = 256;

    fn limits(capacity: &Capacity) -> Limits {
        Limits { preallocated: Some(4 * capacity.window), ..Limits::small(capacity) }
    }
}

impl SliceTopic for SectorHeader {
    type Element = JudgedCell;
    const NAME: &'static str = "sector";
    const FIRST_LENGTH: usize = 1024;

    fn limits(capacity: &Capacity) -> Limits {
        Limits { buffer: 8, borrowed: 8, preallocated: Some(64), ..Limits::small(capacity) }
    }
}

impl SliceTopic for TracksHeader {
    type Element = Track;
    const NAME: &'static str = "tracks";
    const FIRST_LENGTH: usize = 32;

    fn limits(capacity: &Capacity) -> Limits {
        Limits { preallocated: Some(4 * capacity.window), ..Limits::small(capacity) }
    }
}

impl SliceTopic for MovingBeamsHeader {
    type Element = BeamRange;
    const NAME: &'static str = "moving-beams";
    const FIRST_LENGTH: usize = 64;

    fn limits(capacity: &Capacity) -> Limits {
        Limits { preallocated: Some(4 * capacity.window), ..Limits::small(capacity) }
    }
}

/// The header of a scan with more than `LARGE_SCAN_BEAMS` beams: the same fields on a topic with a small buffer.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct LargeScanHeader(pub ScanHeader);

impl Layout for LargeScanHeader {
    const HASH: u64 = ScanHeader::HASH;
}
impl Message for LargeScanHeader {
    const TYPE_NAME: &'static str = "flockslam/large-scan/v1";
}
impl SliceTopic for LargeScanHeader {
    type Element = f32;
    const NAME: &'static str = "large-scan";
    const FIRST_LENGTH: usize = 1;

    fn limits(capacity: &Capacity) -> Limits {
        Limits {
            buffer: 2,
            borrowed: 3,
            preallocated: Some(2 + SCAN_READERS * 3 + 3),
            ..Limits::small(capacity)
        }
    }
}
