//! The kinds of records.

use crate::RecordError;

/// The kinds of records, the most urgent first: what takes little room and changes the map at once goes before what takes much.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Kind {
    /// A record of the same robot does not hold any more.
    Withdrawal = 1,
    /// Measured motions between nodes.
    Constraint = 2,
    /// A stretch of the pose graph with its scans, against which others match.
    Stretch = 3,
    /// Cells of a submap that are stale.
    Clearance = 4,
    /// The evidence of a closed submap.
    Submap = 5,
}

impl Kind {
    /// All of them, the most urgent first.
    pub const ALL: [Kind; 5] =
        [Self::Withdrawal, Self::Constraint, Self::Stretch, Self::Clearance, Self::Submap];

    pub(crate) fn from_number(number: u8) -> Result<Self, RecordError> {
        let known = Self::ALL.into_iter().find(|kind| *kind as u8 == number);
        known.ok_or(RecordError::Kind(number))
    }

    /// Its name in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Withdrawal => "withdrawal",
            Self::Constraint => "constraint",
            Self::Stretch => "stretch",
            Self::Clearance => "clearance",
            Self::Submap => "submap",
        }
    }
}
