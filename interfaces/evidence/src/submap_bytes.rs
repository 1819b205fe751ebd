//! The stored and transmitted form of a submap: compact, canonical, and read with suspicion.
//!
//! Little-endian: `FLSM`, version, number, insertions, first, last, reference pose, cell size, number of tiles; then
//! each tile: key, rows with evidence (64 bits), and for each such row its cells with evidence (64 bits) and their two
//! weights; then in the same way the rows with cleared cells and their masks.

use crate::{PackedCell, Submap, SubmapTile, TILE_CELLS, TILE_SIDE, TileKey};
use flockslam_geometry::Pose;

const MAGIC: [u8; 4] = *b"FLSM";
const VERSION: u8 = 1;
/// Tiles that a submap may have: memory that foreign bytes can ask for is bounded by it (128 MiB).
const TILES_MAX: u32 = 8192;
/// The least bytes of a tile: key and the two words that say which rows follow.
const TILE_BYTES_MIN: usize = 24;

/// Why bytes are not a submap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubmapBytesError {
    /// The bytes end too early.
    #[error("a submap's bytes end in the middle")]
    Truncated,
    /// The bytes are something else.
    #[error("not a submap")]
    NotASubmap,
    /// Written by a build that this one does not know.
    #[error("a submap of version {0}, this build reads version {VERSION}")]
    Version(u8),
    /// More tiles than a bounded submap can have, or than the bytes can hold.
    #[error("a submap of {0} tiles")]
    TooManyTiles(u32),
    /// A pose or cell size that is no number, tiles out of order, or rows that are listed but empty.
    #[error("a submap's content is not well formed")]
    Malformed,
    /// Bytes follow after the end.
    #[error("{0} bytes follow a submap")]
    Trailing(usize),
}

impl Submap {
    /// The stored form. The same submap gives the same bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(96 + self.tiles.len() * 2048);
        out.extend(MAGIC);
        out.push(VERSION);
        out.extend(self.number.to_le_bytes());
        out.extend(self.insertions.to_le_bytes());
        out.extend(self.first.to_le_bytes());
        out.extend(self.last.to_le_bytes());
        let pose = self.odom_from_submap;
        for number in [pose.x_m, pose.y_m, pose.heading_rad, self.cell_size_m] {
            out.extend(number.to_le_bytes());
        }
        out.extend((self.tiles.len() as u32).to_le_bytes());
        for tile in &self.tiles {
            tile.encode(&mut out);
        }
        out
    }

    /// Reads the stored form, from anybody: every length is checked before memory is asked for.
    ///
    /// # Errors
    /// When the bytes are not exactly one well-formed submap.
    pub fn decode(bytes: &[u8]) -> Result<Submap, SubmapBytesError> {
        let mut input = Input(bytes);
        if input.take::<4>()? != MAGIC {
            return Err(SubmapBytesError::NotASubmap);
        }
        let [version] = input.take::<1>()?;
        if version != VERSION {
            return Err(SubmapBytesError::Version(version));
        }
        let (number, insertions) = (input.u32()?, input.u32()?);
        let (first, last) = (input.u64()?, input.u64()?);
        let odom_from_submap = Pose { x_m: input.f64()?, y_m: input.f64()?, heading_rad: input.f64()? };
        let cell_size_m = input.f64()?;
        if !odom_from_submap.is_finite() || !(1e-3..=10.0).contains(&cell_size_m) || last < first {
            return Err(SubmapBytesError::Malformed);
        }
        let count = input.u32()?;
        if count > TILES_MAX || count as usize > input.0.len() / TILE_BYTES_MIN {
            return Err(SubmapBytesError::TooManyTiles(count));
        }
        let mut tiles: Vec<SubmapTile> = Vec::with_capacity(count as usize);
        for _ in 0..count {
            let tile = SubmapTile::decode(&mut input)?;
            if tiles.last().is_some_and(|before| before.key >= tile.key) {
                return Err(SubmapBytesError::Malformed);
            }
            tiles.push(tile);
        }
        if !input.0.is_empty() {
            return Err(SubmapBytesError::Trailing(input.0.len()));
        }
        Ok(Submap { number, insertions, first, last, odom_from_submap, cell_size_m, tiles })
    }
}

impl SubmapTile {
    fn encode(&self, out: &mut Vec<u8>) {
        out.extend(self.key.x.to_le_bytes());
        out.extend(self.key.y.to_le_bytes());
        let rows: [u64; TILE_SIDE] = std::array::from_fn(|y| {
            let row = &self.cells[y * TILE_SIDE..(y + 1) * TILE_SIDE];
            row.iter().enumerate().fold(0, |bits, (x, cell)| bits | (u64::from(!cell.is_unknown()) << x))
        });
        out.extend(nonzero_rows(&rows).to_le_bytes());
        for (y, row) in rows.iter().enumerate().filter(|(_, row)| **row != 0) {
            out.extend(row.to_le_bytes());
            for x in ones(*row) {
                let cell = self.cells[y * TILE_SIDE + x];
                out.extend(cell.occupied.to_le_bytes());
                out.extend(cell.free.to_le_bytes());
            }
        }
        out.extend(nonzero_rows(&self.cleared).to_le_bytes());
        for row in self.cleared.iter().filter(|row| **row != 0) {
            out.extend(row.to_le_bytes());
        }
    }

    fn decode(input: &mut Input<'_>) -> Result<Self, SubmapBytesError> {
        let key = TileKey { x: input.u32()? as i32, y: input.u32()? as i32 };
        let mut tile = Self::new(key, Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
        for y in ones(input.u64()?) {
            for x in ones(input.row()?) {
                let cell = PackedCell { occupied: input.u16()?, free: input.u16()? };
                if cell.is_unknown() {
                    return Err(SubmapBytesError::Malformed);
                }
                tile.cells[y * TILE_SIDE + x] = cell;
            }
        }
        for y in ones(input.u64()?) {
            tile.cleared[y] = input.row()?;
        }
        Ok(tile)
    }
}

/// Bit y is set when row y is not empty.
fn nonzero_rows(rows: &[u64; TILE_SIDE]) -> u64 {
    rows.iter().enumerate().fold(0, |bits, (y, row)| bits | (u64::from(*row != 0) << y))
}

/// Places of the set bits, ascending.
fn ones(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = bits.trailing_zeros() as usize;
        (bits != 0).then(|| {
            bits &= bits - 1;
            place
        })
    })
}

/// What is left to read.
struct Input<'a>(&'a [u8]);

impl Input<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], SubmapBytesError> {
        let (head, tail) = self.0.split_first_chunk::<N>().ok_or(SubmapBytesError::Truncated)?;
        self.0 = tail;
        Ok(*head)
    }

    fn u16(&mut self) -> Result<u16, SubmapBytesError> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, SubmapBytesError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, SubmapBytesError> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, SubmapBytesError> {
        self.take().map(f64::from_le_bytes)
    }

    /// A row's bits; only rows that are not empty are written.
    fn row(&mut self) -> Result<u64, SubmapBytesError> {
        let bits = self.u64()?;
        if bits == 0 { Err(SubmapBytesError::Malformed) } else { Ok(bits) }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A submap with a few cells of evidence and some of them cleared.
    pub(crate) fn submap() -> impl Strategy<Value = Submap> {
        let cell = (-90i32..90, -90i32..90, 0u16..9000, 1u16..9000, any::<bool>());
        (proptest::collection::vec(cell, 0..60), -3.0..3.0f64, -2.0..2.0f64).prop_map(
            |(cells, heading, x)| {
                let mut tiles = std::collections::BTreeMap::new();
                for (x, y, occupied, free, cleared) in cells {
                    let index = crate::CellIndex::new(x, y);
                    let empty = || SubmapTile::new(index.tile(), Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
                    let tile = tiles.entry(index.tile()).or_insert_with(empty);
                    tile.cells[index.offset()] = PackedCell { occupied, free };
                    if cleared {
                        tile.clear(index.offset());
                    }
                }
                let odom_from_submap = Pose::new(x, 0.5, heading);
                let tiles = tiles.into_values().collect();
                Submap {
                    number: 3,
                    insertions: 7,
                    first: 40,
                    last: 61,
                    odom_from_submap,
                    cell_size_m: 0.05,
                    tiles,
                }
            },
        )
    }

    proptest! {
        #[test]
        fn what_was_written_is_read(submap in submap()) {
            let bytes = submap.encode();
            prop_assert_eq!(Submap::decode(&bytes), Ok(submap));
        }

        #[test]
        fn damaged_bytes_are_refused_or_another_submap_but_never_a_crash(
            submap in submap(), place in any::<prop::sample::Index>(), flip in 1u8.., cut in any::<prop::sample::Index>()
        ) {
            let mut bytes = submap.encode();
            prop_assert!(Submap::decode(&bytes[..cut.index(bytes.len())]).is_err());
            let place = place.index(bytes.len());
            bytes[place] ^= flip;
            if let Ok(other) = Submap::decode(&bytes) {
                prop_assert_eq!(other.encode(), bytes, "the form is canonical");
            }
        }
    }

    #[test]
    fn sizes_are_checked_before_memory_is_asked_for() {
        let empty = Submap {
            number: 0,
            insertions: 0,
            first: 0,
            last: 0,
            odom_from_submap: Pose::IDENTITY,
            cell_size_m: 0.05,
            tiles: Vec::new(),
        };
        let mut bytes = empty.encode();
        let count = bytes.len() - 4;
        bytes[count..].fill(0xff);
        assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::TooManyTiles(u32::MAX)));
        bytes[4] = 9;
        assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::Version(9)));
        assert_eq!(Submap::decode(b"PNG"), Err(SubmapBytesError::Truncated));
    }
}
