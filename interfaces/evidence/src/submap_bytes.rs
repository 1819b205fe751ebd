//! The stored and transmitted form of a submap: compact, and read with suspicion.
//!
//! Little-endian: `FLSM`, version, checksum (CRC-32 of all that follows), number, trajectory, insertions, first, last, reference pose,
//! cell size; the levels of both weights (count, then each weight); the number of tiles and their keys, each as the
//! difference to the one before; the tiles with cleared cells, as place, rows (64 bits) and a mask for each row; then to the end
//! the cells, as places among the levels, range coded by [`CellModel`].

use crate::cell_coder::{CellModel, Symbol};
use crate::range_coder::{RangeDecoder, RangeEncoder};
use crate::weight_levels::{CellLevels, Levels};
use crate::{PackedCell, Submap, SubmapTile, TILE_CELLS, TileKey};
use flockslam_geometry::Pose;

const MAGIC: [u8; 4] = *b"FLSM";
const VERSION: u8 = 2;
/// Where the bytes begin that the checksum is of.
const CHECKED_FROM: usize = 9;
/// Bytes from there to the levels: three numbers of 32 bits, two of 64, the reference pose and the size of a cell.
const HEAD_BYTES: usize = 3 * 4 + 2 * 8 + 4 * 8;
/// Tiles that a submap may have: memory that foreign bytes can ask for is bounded by it (128 MiB).
const TILES_MAX: u32 = 8192;
/// The least bytes of a tile: those of its key.
const TILE_BYTES_MIN: usize = 2;

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
    /// The bytes have changed since they were written.
    #[error("a submap's bytes are damaged")]
    Damaged,
    /// More tiles than a bounded submap can have, or than the bytes can hold.
    #[error("a submap of {0} tiles")]
    TooManyTiles(u32),
    /// A pose or cell size that is no number, tiles out of order, rows that are listed but empty, or a level that is not.
    #[error("a submap's content is not well formed")]
    Malformed,
    /// Bytes follow after the end.
    #[error("{0} bytes follow a submap")]
    Trailing(usize),
}

impl Submap {
    /// The stored form: of [`Submap::quantised`], which is what [`Submap::decode`] gives. The same submap gives the same bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(4096);
        out.extend(MAGIC);
        out.push(VERSION);
        out.extend([0; 4]);
        out.extend(self.number.to_le_bytes());
        out.extend(self.trajectory.to_le_bytes());
        out.extend(self.insertions.to_le_bytes());
        out.extend(self.first.to_le_bytes());
        out.extend(self.last.to_le_bytes());
        let pose = self.odom_from_submap;
        for number in [pose.x_m, pose.y_m, pose.heading_rad, self.cell_size_m] {
            out.extend(number.to_le_bytes());
        }
        let levels = CellLevels::of(&self.tiles);
        encode_levels(&levels.occupied, &mut out);
        encode_levels(&levels.free, &mut out);
        encode_keys(&self.tiles, &mut out);
        encode_masks(&self.tiles, &mut out);
        let mut out = encode_cells(&self.tiles, &levels, out);
        seal(&mut out);
        out
    }

    /// The stored form of a submap of which `stored` is an earlier stored form: only the cells that are masked may have changed. The same
    /// bytes as [`Self::encode`] gives, without coding the cells anew.
    ///
    /// # Errors
    /// When `stored` is not a stored form of this submap.
    pub fn encode_cleared(&self, stored: &[u8]) -> Result<Vec<u8>, SubmapBytesError> {
        let mut input = checked(stored)?;
        input.take::<HEAD_BYTES>()?;
        decode_levels(&mut input)?;
        decode_levels(&mut input)?;
        let keys = decode_keys(&mut input, TILES_MAX as usize)?;
        if !keys.iter().eq(self.tiles.iter().map(|tile| &tile.key)) {
            return Err(SubmapBytesError::Malformed);
        }
        let mut out = stored[..stored.len() - input.0.len()].to_vec();
        for _ in 0..input.u32()? {
            input.u32()?;
            for _ in 0..input.u64()?.count_ones() {
                input.u64()?;
            }
        }
        encode_masks(&self.tiles, &mut out);
        out.extend(input.0);
        seal(&mut out);
        Ok(out)
    }

    /// Reads the stored form, which may be hostile: every length is checked before memory is allocated.
    ///
    /// # Errors
    /// When the bytes are not exactly one well-formed submap.
    pub fn decode(bytes: &[u8]) -> Result<Submap, SubmapBytesError> {
        Self::decode_bounded(bytes, TILES_MAX as usize)
    }

    /// The same of a submap with at most `tiles_max` tiles of 16 KiB, when less memory is to be asked for.
    ///
    /// # Errors
    /// As [`Self::decode`], and when there are more tiles.
    pub fn decode_bounded(bytes: &[u8], tiles_max: usize) -> Result<Submap, SubmapBytesError> {
        let mut input = checked(bytes)?;
        let (number, trajectory, insertions) = (input.u32()?, input.u32()?, input.u32()?);
        let (first, last) = (input.u64()?, input.u64()?);
        let odom_from_submap = Pose { x_m: input.f64()?, y_m: input.f64()?, heading_rad: input.f64()? };
        let cell_size_m = input.f64()?;
        if !odom_from_submap.is_finite() || !(1e-3..=10.0).contains(&cell_size_m) || last < first {
            return Err(SubmapBytesError::Malformed);
        }
        let levels = CellLevels { occupied: decode_levels(&mut input)?, free: decode_levels(&mut input)? };
        let keys = decode_keys(&mut input, tiles_max)?;
        let empty = |key| SubmapTile::new(key, Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
        let mut tiles: Vec<SubmapTile> = keys.into_iter().map(empty).collect();
        decode_masks(&mut input, &mut tiles)?;
        decode_cells(input.0, &levels, &mut tiles)?;
        Ok(Submap { number, trajectory, insertions, first, last, odom_from_submap, cell_size_m, tiles })
    }
}

/// What follows the checksum, which must be right.
fn checked(bytes: &[u8]) -> Result<Input<'_>, SubmapBytesError> {
    let mut input = Input(bytes);
    if input.take::<4>()? != MAGIC {
        return Err(SubmapBytesError::NotASubmap);
    }
    let [version] = input.take::<1>()?;
    if version != VERSION {
        return Err(SubmapBytesError::Version(version));
    }
    if input.u32()? != crc32fast::hash(input.0) {
        return Err(SubmapBytesError::Damaged);
    }
    Ok(input)
}

/// Writes the checksum.
fn seal(out: &mut [u8]) {
    let checksum = crc32fast::hash(&out[CHECKED_FROM..]);
    out[CHECKED_FROM - 4..CHECKED_FROM].copy_from_slice(&checksum.to_le_bytes());
}

fn encode_levels(levels: &Levels, out: &mut Vec<u8>) {
    out.push(levels.weights().len() as u8);
    levels.weights().iter().for_each(|weight| out.extend(weight.to_le_bytes()));
}

fn decode_levels(input: &mut Input<'_>) -> Result<Levels, SubmapBytesError> {
    let [count] = input.take::<1>()?;
    let mut levels = Levels::default();
    for _ in 0..count {
        if !levels.push(input.u16()?) {
            return Err(SubmapBytesError::Malformed);
        }
    }
    Ok(levels)
}

fn encode_keys(tiles: &[SubmapTile], out: &mut Vec<u8>) {
    out.extend((tiles.len() as u32).to_le_bytes());
    let mut before = TileKey::default();
    for TileKey { x, y } in tiles.iter().map(|tile| tile.key) {
        encode_difference(before.x, x, out);
        encode_difference(before.y, y, out);
        before = TileKey { x, y };
    }
}

fn decode_keys(input: &mut Input<'_>, tiles_max: usize) -> Result<Vec<TileKey>, SubmapBytesError> {
    let count = input.u32()?;
    if count as usize > tiles_max.min(TILES_MAX as usize) || count as usize > input.0.len() / TILE_BYTES_MIN {
        return Err(SubmapBytesError::TooManyTiles(count));
    }
    let mut keys: Vec<TileKey> = Vec::with_capacity(count as usize);
    for _ in 0..count {
        let before = keys.last().copied();
        let TileKey { x, y } = before.unwrap_or_default();
        let key = TileKey { x: decode_difference(x, input)?, y: decode_difference(y, input)? };
        if before.is_some_and(|before| before >= key) {
            return Err(SubmapBytesError::Malformed);
        }
        keys.push(key);
    }
    Ok(keys)
}

/// A small difference in one byte, any in six: groups of seven bits, the lowest first, the sign lowest of all.
fn encode_difference(from: i32, to: i32, out: &mut Vec<u8>) {
    let difference = i64::from(to) - i64::from(from);
    let mut rest = (difference << 1 ^ difference >> 63) as u64;
    while rest >= 0x80 {
        out.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    out.push(rest as u8);
}

fn decode_difference(from: i32, input: &mut Input<'_>) -> Result<i32, SubmapBytesError> {
    let mut folded = 0u64;
    for shift in (0..35).step_by(7) {
        let [byte] = input.take::<1>()?;
        folded |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            let difference = (folded >> 1) as i64 ^ -((folded & 1) as i64);
            let to = i64::from(from) + difference;
            return i32::try_from(to).map_err(|_| SubmapBytesError::Malformed);
        }
    }
    Err(SubmapBytesError::Malformed)
}

fn encode_masks(tiles: &[SubmapTile], out: &mut Vec<u8>) {
    let rows = |tile: &SubmapTile| {
        let bit = |(y, row): (usize, &u64)| u64::from(*row != 0) << y;
        tile.cleared.iter().enumerate().map(bit).sum::<u64>()
    };
    let cleared = tiles.iter().enumerate().filter(|(_, tile)| rows(tile) != 0);
    out.extend((cleared.clone().count() as u32).to_le_bytes());
    for (place, tile) in cleared {
        out.extend((place as u32).to_le_bytes());
        out.extend(rows(tile).to_le_bytes());
        tile.cleared.iter().filter(|row| **row != 0).for_each(|row| out.extend(row.to_le_bytes()));
    }
}

fn decode_masks(input: &mut Input<'_>, tiles: &mut [SubmapTile]) -> Result<(), SubmapBytesError> {
    let mut next = 0;
    for _ in 0..input.u32()? {
        let place = input.u32()? as usize;
        let rows = input.u64()?;
        let tile = tiles.get_mut(place).filter(|_| place >= next && rows != 0);
        let tile = tile.ok_or(SubmapBytesError::Malformed)?;
        for (y, row) in tile.cleared.iter_mut().enumerate() {
            if rows >> y & 1 == 1 {
                *row = Some(input.u64()?).filter(|row| *row != 0).ok_or(SubmapBytesError::Malformed)?;
            }
        }
        next = place + 1;
    }
    Ok(())
}

fn encode_cells(tiles: &[SubmapTile], levels: &CellLevels, out: Vec<u8>) -> Vec<u8> {
    let (mut coder, mut model) = (RangeEncoder::new(out), CellModel::new(levels));
    let mut symbols = [[0; 2]; TILE_CELLS];
    for tile in tiles {
        for (symbol, cell) in symbols.iter_mut().zip(tile.cells.iter()) {
            *symbol = if cell.is_unknown() { [0; 2] } else { levels.places(*cell) };
        }
        model.code(&mut coder, &mut symbols);
    }
    coder.finish()
}

fn decode_cells(bytes: &[u8], levels: &CellLevels, tiles: &mut [SubmapTile]) -> Result<(), SubmapBytesError> {
    let (mut coder, mut model) = (RangeDecoder::new(bytes), CellModel::new(levels));
    let mut symbols: [Symbol; TILE_CELLS] = [[0; 2]; TILE_CELLS];
    for tile in tiles {
        model.code(&mut coder, &mut symbols);
        for (cell, symbol) in tile.cells.iter_mut().zip(&symbols).filter(|(_, symbol)| **symbol != [0; 2]) {
            *cell = levels.cell(*symbol).ok_or(SubmapBytesError::Malformed)?;
        }
    }
    // Zeros at the end are never written.
    match (coder.left(), bytes.last()) {
        (0, None | Some(1..)) => Ok(()),
        (left, _) => Err(SubmapBytesError::Trailing(left.max(1))),
    }
}

/// The bytes that are left to read.
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
                    trajectory: 0,
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
            let read = Submap::decode(&bytes).unwrap();
            prop_assert_eq!(read.encode(), bytes);
            prop_assert_eq!(read, submap.quantised());
        }

        #[test]
        fn masks_are_written_anew_without_the_cells(
            submap in submap(), more in proptest::collection::vec((-90i32..90, -90i32..90), 0..20), unmasks in any::<bool>()
        ) {
            let stored = submap.encode();
            let mut changed = Submap::decode(&stored).unwrap();
            if unmasks {
                changed.set_cleared(&crate::ClearedCells::default());
            }
            for (x, y) in more {
                changed.clear(crate::CellIndex::new(x, y));
            }
            prop_assert_eq!(changed.encode_cleared(&stored), Ok(changed.encode()));
        }

        #[test]
        fn damaged_bytes_are_refused(
            submap in submap(), place in any::<prop::sample::Index>(), flip in 1u8.., cut in any::<prop::sample::Index>()
        ) {
            let mut bytes = submap.encode();
            prop_assert!(Submap::decode(&bytes[..cut.index(bytes.len())]).is_err());
            let place = place.index(bytes.len());
            bytes[place] ^= flip;
            prop_assert!(Submap::decode(&bytes).is_err());
        }

        #[test]
        fn forged_bytes_are_refused_or_a_submap_but_never_a_crash(
            submap in submap(), place in any::<prop::sample::Index>(), flip in 1u8..
        ) {
            let mut bytes = submap.encode();
            let place = CHECKED_FROM + place.index(bytes.len() - CHECKED_FROM);
            bytes[place] ^= flip;
            if let Ok(other) = Submap::decode(&signed(bytes)) {
                prop_assert_eq!(Submap::decode(&other.encode()), Ok(other));
            }
        }

        #[test]
        fn keys_come_back(keys in proptest::collection::btree_set((any::<i32>(), any::<i32>()), 0..20)) {
            let cells = Box::new([PackedCell { occupied: 0, free: 3 }; TILE_CELLS]);
            let tiles = keys.into_iter().map(|(x, y)| SubmapTile::new(TileKey { x, y }, cells.clone()));
            let submap = Submap { tiles: tiles.collect(), ..empty() };
            prop_assert_eq!(Submap::decode(&submap.encode()), Ok(submap));
        }
    }

    fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
        let checksum = crc32fast::hash(&bytes[CHECKED_FROM..]);
        bytes[CHECKED_FROM - 4..CHECKED_FROM].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    fn empty() -> Submap {
        Submap {
            number: 0,
            trajectory: 0,
            insertions: 0,
            first: 0,
            last: 0,
            odom_from_submap: Pose::IDENTITY,
            cell_size_m: 0.05,
            tiles: Vec::new(),
        }
    }

    #[test]
    fn sizes_are_checked_before_allocation() {
        let mut bytes = empty().encode();
        let count = bytes.len() - 8;
        bytes[count..count + 4].fill(0xff);
        let mut bytes = signed(bytes);
        assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::TooManyTiles(u32::MAX)));
        bytes[9] ^= 1;
        assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::Damaged));
        bytes[4] = 9;
        assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::Version(9)));
        assert_eq!(Submap::decode(b"PNG"), Err(SubmapBytesError::Truncated));
        let long = [empty().encode(), vec![0; 8]].concat();
        assert_eq!(Submap::decode(&signed(long)), Err(SubmapBytesError::Trailing(3)));
    }
}
