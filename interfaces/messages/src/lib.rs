//! Every payload that crosses a process or robot boundary, with its layout and version.
//!
//! A message is plain data: `#[repr(C)]`, no padding, no pointers, readable in place from shared memory. Its version
//! is part of its type name and its layout is hashed, so two builds that disagree refuse each other.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod control;
mod correction;
mod deskew;
mod flock_frame;
mod grid_update;
mod localisation_order;
mod marks;
mod message;
mod moving_beams;
mod pose_estimate;
mod scan;
mod scan_id;
mod scan_tally;
mod stage_inputs;
mod stage_progress;
mod tracks;
mod verdict;

pub use control::{Control, ControlKind};
pub use correction::Correction;
pub use deskew::Deskew;
pub use flock_frame::{FLOCK_ROBOTS_MAX, FlockFrame, FlockRobot, FlockRobots};
pub use grid_update::{Commit, CommitName, PartInserted, SubmapClosed, TileMessage};
pub use localisation_order::LocalisationOrder;
pub use marks::{ClearedCell, JudgedCell, MarksHeader, SectorHeader};
pub use message::{Layout, Message};
pub use moving_beams::{BeamRange, MovingBeamsHeader};
pub use pose_estimate::{PoseEstimate, PoseFlags, Quality};
pub use scan::{
    HEADING_ONLY, LARGE_SCAN_BEAMS, STARTS_DETACHED, ScanBuffer, ScanHeader, ScanProblem, ScanSections,
    ScanView,
};
pub use scan_id::{ScanId, Times};
pub use scan_tally::{ScanTally, TALLY_BINS, TALLY_SECTORS};
pub use stage_inputs::{StageInputs, StageStart};
pub use stage_progress::{Progress, Stage};
pub use tracks::{Track, TracksHeader};
pub use verdict::{DropReason, KeepReason, Verdict};
