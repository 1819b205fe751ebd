use crate::message::message;
use crate::{ScanId, Times};

message! {
    /// What the correlation filter says of a scan.
    pub struct Verdict = "flockslam/verdict/v1" {
        /// The scan.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// The smallest correlation with a scan of the window (what decided); NaN when none was computed.
        pub coefficient: f64,
        /// 1 = process the scan, 0 = drop it.
        pub keep: u32,
        /// Why: a [`DropReason`] as number when dropped, 0 when kept.
        pub reason: u32,
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
    /// Live: load was shed.
    Overload = 4,
    /// Live: no verdict came in time (the scan is processed nevertheless).
    Deadline = 5,
}

impl DropReason {
    /// All reasons.
    pub const ALL: [DropReason; 5] =
        [Self::Correlated, Self::Empty, Self::Withheld, Self::Overload, Self::Deadline];

    /// The name used in metrics and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Correlated => "correlated",
            Self::Empty => "empty",
            Self::Withheld => "withheld",
            Self::Overload => "overload",
            Self::Deadline => "deadline",
        }
    }

    /// The reason with this number, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| *reason as u32 == number)
    }
}
