//! The content of a clearance: cells of one tile of a submap that count as unknown.

use crate::codec::{Reader, Writer};
use crate::{RecordError, RobotId};
use flockslam_evidence::{TILE_SIDE, TileKey};

/// Cells of one tile of a submap, own or foreign, that its author found stale: they count as unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Clearance {
    /// Whose submap.
    pub robot: RobotId,
    /// Epoch of the submap.
    pub epoch: u64,
    /// Number of the submap.
    pub submap: u32,
    /// Which tile of it.
    pub tile: TileKey,
    /// The cells, one bit each, row by row.
    pub rows: Box<[u64; TILE_SIDE]>,
}

impl Clearance {
    pub(crate) fn write(&self, out: &mut Writer) {
        out.robot(&self.robot);
        out.u64(self.epoch);
        out.u32(self.submap);
        out.signed(self.tile.x.into());
        out.signed(self.tile.y.into());
        let listed = self.rows.iter().enumerate().filter(|(_, row)| **row != 0);
        out.u64(listed.clone().fold(0, |rows, (row, _)| rows | 1 << row));
        listed.for_each(|(_, row)| out.u64(*row));
    }

    pub(crate) fn read(input: &mut Reader<'_>) -> Result<Self, RecordError> {
        let (robot, epoch, submap) = (input.robot()?, input.u64()?, input.u32()?);
        let wrong = |_| RecordError::Malformed("a tile");
        let x = i32::try_from(input.signed()?).map_err(wrong)?;
        let y = i32::try_from(input.signed()?).map_err(wrong)?;
        let listed = input.u64()?;
        let mut rows = Box::new([0; TILE_SIDE]);
        for (_, row) in rows.iter_mut().enumerate().filter(|(number, _)| listed >> number & 1 == 1) {
            *row = input.u64()?;
            if *row == 0 {
                return Err(RecordError::Malformed("a row of cleared cells"));
            }
        }
        Ok(Self { robot, epoch, submap, tile: TileKey { x, y }, rows })
    }
}
