//! Every payload that crosses a process or robot boundary, with its layout and version.
//!
//! A message is plain data: `#[repr(C)]`, no padding, no pointers, readable in place from shared memory. Its version
//! is part of its type name and its layout is hashed, so two builds that disagree refuse each other.

mod control;
mod correction;
mod deskew;
mod flock;
mod grid;
mod identity;
mod marks;
mod message;
mod moving;
mod pose;
mod progress;
mod scan;
mod tally;
mod tracks;
mod verdict;

pub use control::{Control, ControlKind};
pub use correction::Correction;
pub use deskew::Deskew;
pub use flock::{FLOCK_ROBOTS_MAX, FlockFrame, FlockRobot, FlockRobots};
pub use grid::{Commit, PartInserted, SubmapClosed, TileMessage};
pub use identity::{ScanId, Times};
pub use marks::{ClearedCell, JudgedCell, MarksHeader, SectorHeader};
pub use message::{Layout, Message};
pub use moving::{BeamRange, MovingBeamsHeader};
pub use pose::{PoseEstimate, PoseFlags, Quality};
pub use progress::{Progress, Stage};
pub use scan::{LARGE_SCAN_BEAMS, ScanBuffer, ScanHeader, ScanProblem, ScanSections, ScanView};
pub use tally::{ScanTally, TALLY_BINS, TALLY_SECTORS};
pub use tracks::{Track, TracksHeader};
pub use verdict::{DropReason, KeepReason, Verdict};
