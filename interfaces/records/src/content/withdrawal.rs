//! The content of a withdrawal: the name of an earlier record of the same robot.

use crate::RecordError;
use crate::codec::{Reader, Writer};

/// Withdraws a record of the same robot. It names no robot: only the author can withdraw a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Withdrawal {
    /// Epoch of the record that does not hold any more.
    pub epoch: u64,
    /// Its number.
    pub number: u64,
}

impl Withdrawal {
    pub(crate) fn write(&self, out: &mut Writer) {
        out.u64(self.epoch);
        out.u64(self.number);
    }

    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        Ok(Self { epoch: input.u64()?, number: input.u64()? })
    }
}
