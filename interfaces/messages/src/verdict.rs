//! The message of the correlation filter: keep or drop a scan, with the reason.

use crate::message::message;
use crate::{ScanId, Times};

message! {
    /// The verdict of the correlation filter on a scan.
    pub struct Verdict = "flockslam/verdict/v2" {
        /// The scan.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// The smallest correlation with a scan of the window (what decided), −1 … 1; 0 when none was computed.
        pub coefficient: f64,
        /// 1 = process the scan, 0 = drop it.
        pub keep: u32,
        /// Why: a [`DropReason`] as number when dropped, a [`KeepReason`] when kept.
        pub reason: u32,
    }
}

impl Verdict {
    /// The reason for a drop as a number, 0 when the scan is kept.
    pub fn drop_reason(&self) -> u32 {
        if self.keep == 0 { self.reason } else { 0 }
    }
}

/// Why a scan is not processed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum DropReason {
    /// It correlates with every scan of the window.
    Correlated = 1,
    /// It has no valid range.
    Empty = 2,
    /// The source withheld it (an experiment).
    Withheld = 3,
    /// Live: the matcher is behind, and load was shed.
    Overload = 4,
    /// Live: no verdict came in time (the scan is processed nevertheless).
    Deadline = 5,
    /// Nothing has changed since the last kept scan: the robot stands still.
    Unchanged = 6,
    /// Odometry has hardly moved since the last kept scan.
    Motion = 7,
    /// Live: the set is paused; the sensor goes on.
    Paused = 8,
}

/// Why a scan is processed. The numbers are none of [`DropReason`]'s.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum KeepReason {
    /// The filter is off, or has no reference to compare with.
    Unfiltered = 32,
    /// There are too few kept scans to compare with.
    FirstScans = 33,
    /// It differs from a kept scan.
    Novel = 34,
    /// It looks like a corridor, where all scans look alike.
    Corridor = 35,
    /// The robot has moved far since the last kept scan.
    Travel = 36,
    /// Too many were dropped in a row.
    InARow = 37,
    /// No verdict was there in time (live).
    Late = 38,
}

impl KeepReason {
    /// All reasons.
    pub const ALL: [KeepReason; 7] = [
        Self::Unfiltered,
        Self::FirstScans,
        Self::Novel,
        Self::Corridor,
        Self::Travel,
        Self::InARow,
        Self::Late,
    ];

    /// The name used in metrics and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unfiltered => "unfiltered",
            Self::FirstScans => "first-scans",
            Self::Novel => "novel",
            Self::Corridor => "corridor",
            Self::Travel => "travel",
            Self::InARow => "in-a-row",
            Self::Late => "late",
        }
    }

    /// The reason with this number, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| *reason as u32 == number)
    }
}

impl DropReason {
    /// All reasons.
    pub const ALL: [DropReason; 8] = [
        Self::Correlated,
        Self::Empty,
        Self::Withheld,
        Self::Overload,
        Self::Deadline,
        Self::Unchanged,
        Self::Motion,
        Self::Paused,
    ];

    /// The name used in metrics and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Correlated => "correlated",
            Self::Empty => "empty",
            Self::Withheld => "withheld",
            Self::Overload => "overload",
            Self::Deadline => "deadline",
            Self::Unchanged => "unchanged",
            Self::Motion => "motion",
            Self::Paused => "paused",
        }
    }

    /// The reason with this number, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| *reason as u32 == number)
    }
}
