//! The content of a closed submap: its stored form, unpacked only where it is needed.

use crate::RecordError;
use crate::codec::{Reader, Writer};
use flockslam_evidence::Submap;

/// Most tiles of a submap that comes from another robot: 10 m of travel with a lidar of 30 m see less.
const TILES_MAX: usize = 1024;

/// The evidence of a closed submap, as [`Submap::encode`] writes it.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapRecord {
    /// Its number in its robot's epoch.
    pub number: u32,
    /// The stored form; [`SubmapRecord::submap`] unpacks it.
    pub bytes: Vec<u8>,
}

impl SubmapRecord {
    /// The record of a submap.
    pub fn of(submap: &Submap) -> Self {
        Self { number: submap.number, bytes: submap.encode() }
    }

    /// The submap itself: up to 16 MiB, so that it is unpacked only where it is needed.
    ///
    /// # Errors
    /// When the bytes are not a submap of this number and of a bounded size.
    pub fn submap(&self) -> Result<Submap, RecordError> {
        match Submap::decode_bounded(&self.bytes, TILES_MAX) {
            Ok(submap) if submap.number == self.number => Ok(submap),
            _ => Err(RecordError::Malformed("a submap")),
        }
    }

    pub(crate) fn write(&self, out: &mut Writer) {
        out.u32(self.number);
        out.bytes(&self.bytes);
    }

    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        let number = input.u32()?;
        let bytes = input.take(input.0.len())?.to_vec();
        Ok(Self { number, bytes })
    }
}
