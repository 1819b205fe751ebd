//! Counters of a reader: lines, scans, and what was rejected by reason.

use super::Rejection;
use std::collections::BTreeMap;

/// Counts of a reader so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Lines, of whatever kind.
    pub lines: u64,
    /// Scans given out.
    pub scans: u64,
    /// Lines with a message that this reader does not know.
    pub unknown: u64,
    /// Bad lines and scans that were skipped, by reason.
    pub rejected: BTreeMap<Rejection, u64>,
    /// The first bad line: its number (from 1) and what is wrong with it.
    pub first_rejected: Option<(u64, Rejection)>,
    /// Beams that are no returns: out of the sensor's limits, infinite or NaN.
    pub invalid_beams: u64,
    /// Scans whose stamp was not later than the one before; where a period is needed the nominal one is meant.
    pub steps_backward: u64,
    /// Scans that a recording of a set reports as missed.
    pub missing: u64,
}

impl Tally {
    /// Those in all.
    pub fn rejected_lines(&self) -> u64 {
        self.rejected.values().sum()
    }

    /// Lines that are no message; a scan that is refused stands in a sound one.
    pub(super) fn bad_lines(&self) -> u64 {
        let of_line = |reason: &Rejection| !matches!(reason, Rejection::TimeReversed | Rejection::Frozen);
        self.rejected.iter().filter(|(reason, _)| of_line(reason)).map(|(_, count)| count).sum()
    }

    pub(crate) fn reject(&mut self, rejection: Rejection) {
        *self.rejected.entry(rejection).or_default() += 1;
        self.first_rejected.get_or_insert((self.lines, rejection));
    }
}
