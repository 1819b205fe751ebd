//! The stored and transmitted form of a submap: compact, and read with suspicion.
//!
//! Little-endian: `FLSM`, version, checksum (CRC-32 of all that follows), number, trajectory, insertions, first, last, reference pose,
//! cell size; the number of tiles and their keys, each as the difference to the one before; the blocks of each tile that have evidence
//! (64 bits); the levels of both weights (count, then each weight); the tiles with cleared cells, as place, rows (64 bits) and a mask for
//! each row; then to the end the cells of those blocks, as places among the levels, range coded by [`CellModel`].
//! Submaps of version 2 are read too.

use crate::cell_coder::{CellModel, Symbol};
use crate::range_coder::{RangeDecoder, RangeEncoder};
use crate::submap_outline::{block_rows, known_blocks};
use crate::submap_version_2;
use crate::weight_levels::{CellLevels, Levels};
use crate::{CellIndex, PackedCell, Submap, SubmapOutline, SubmapTile, TILE_CELLS, TILE_SIDE, TileKey};
use flockslam_geometry::Pose;
use std::borrow::Cow;

const MAGIC: [u8; 4] = *b"FLSM";
const VERSION: u8 = 3;
/// The version before, which is read and no longer written.
const VERSION_BEFORE: u8 = 2;
/// Where the byte of the version is.
const VERSION_AT: usize = MAGIC.len();
/// Where the bytes begin that the checksum is of.
const CHECKED_FROM: usize = 9;
/// Tiles that a submap may have: memory that foreign bytes can ask for is bounded by it (128 MiB).
const TILES_MAX: u32 = 8192;
/// The least bytes of a tile: those of its key, and of its blocks, which version 2 had not.
const TILE_BYTES_MIN: usize = KEY_BYTES_MIN + 8;
pub(crate) const KEY_BYTES_MIN: usize = 2;

/// The cells of a tile that are masked, one bit each, row by row.
pub(crate) type Mask = [u64; TILE_SIDE];

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
    #[error("a submap of version {0}, this build reads versions {VERSION_BEFORE} and {VERSION}")]
    Version(u8),
    /// The bytes have changed since they were written.
    #[error("a submap's bytes are damaged")]
    Damaged,
    /// More tiles than a bounded submap can have, or than the bytes can hold.
    #[error("a submap of {0} tiles")]
    TooManyTiles(u32),
    /// A pose or cell size that is no number, tiles out of order, rows or blocks that are listed but empty, or a level that is not.
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
        let outline = SubmapOutline::of(self);
        encode_keys(&outline.blocks, &mut out);
        outline.blocks.iter().for_each(|(_, blocks)| out.extend(blocks.to_le_bytes()));
        let levels = CellLevels::of(&self.tiles, &outline.blocks);
        encode_levels(&levels.occupied, &mut out);
        encode_levels(&levels.free, &mut out);
        encode_masks(self.tiles.iter().map(|tile| &tile.cleared), &mut out);
        let mut out = encode_cells(&self.tiles, &outline.blocks, &levels, out);
        seal(&mut out);
        out
    }

    /// The stored form of a submap of which `stored` is an earlier stored form: only the cells that are masked may have changed. The same
    /// bytes as [`Self::encode`] gives, without coding the cells anew.
    ///
    /// # Errors
    /// When `stored` is not a stored form of this submap.
    pub fn encode_cleared(&self, stored: &[u8]) -> Result<Vec<u8>, SubmapBytesError> {
        let stored = in_this_version(stored)?;
        let mut parts = Parts::of(&stored)?;
        if !parts.keys().eq(self.tiles.iter().map(|tile| tile.key)) {
            return Err(SubmapBytesError::Malformed);
        }
        parts.masks = self.tiles.iter().map(|tile| tile.cleared).collect();
        Ok(parts.sealed())
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
        if bytes[VERSION_AT] == VERSION_BEFORE {
            return submap_version_2::decode(input, tiles_max);
        }
        let SubmapOutline { emptied, blocks } = decode_outline(&mut input, tiles_max)?;
        let levels = CellLevels { occupied: decode_levels(&mut input)?, free: decode_levels(&mut input)? };
        let masks = decode_masks(&mut input, blocks.len())?;
        let mut tiles = unknown_tiles(blocks.iter().map(|(key, _)| *key), masks);
        decode_cells(input.0, &blocks, &levels, &mut tiles)?;
        Ok(Submap { tiles, ..emptied })
    }
}

impl SubmapOutline {
    /// Reads the outline from the stored form of a submap, and nothing of its cells.
    ///
    /// # Errors
    /// When the bytes are damaged, or their head is not that of a well-formed submap.
    pub fn decode(bytes: &[u8]) -> Result<SubmapOutline, SubmapBytesError> {
        let bytes = in_this_version(bytes)?;
        decode_outline(&mut checked(&bytes)?, TILES_MAX as usize)
    }
}

/// The stored form of a submap that is stored so, with these cells masked too; those that it has no tiles for are passed over.
///
/// # Errors
/// When the bytes are damaged or not well formed.
pub fn with_masked(stored: &[u8], cells: &[CellIndex]) -> Result<Vec<u8>, SubmapBytesError> {
    let stored = in_this_version(stored)?;
    let mut parts = Parts::of(&stored)?;
    for cell in cells {
        if let Ok(place) = parts.blocks.binary_search_by_key(&cell.tile(), |(key, _)| *key) {
            let offset = cell.offset();
            parts.masks[place][offset / TILE_SIDE] |= 1 << (offset % TILE_SIDE);
        }
    }
    Ok(parts.sealed())
}

/// A stored form, taken apart so that its masks can be changed.
struct Parts<'a> {
    before_masks: &'a [u8],
    blocks: Vec<(TileKey, u64)>,
    masks: Vec<Mask>,
    cells: &'a [u8],
}

impl<'a> Parts<'a> {
    fn of(stored: &'a [u8]) -> Result<Self, SubmapBytesError> {
        let mut input = checked(stored)?;
        let SubmapOutline { blocks, .. } = decode_outline(&mut input, TILES_MAX as usize)?;
        decode_levels(&mut input)?;
        decode_levels(&mut input)?;
        let before_masks = &stored[..stored.len() - input.0.len()];
        let masks = decode_masks(&mut input, blocks.len())?;
        Ok(Self { before_masks, blocks, masks, cells: input.0 })
    }

    fn keys(&self) -> impl Iterator<Item = TileKey> {
        self.blocks.iter().map(|(key, _)| *key)
    }

    fn sealed(&self) -> Vec<u8> {
        let mut out = self.before_masks.to_vec();
        encode_masks(self.masks.iter(), &mut out);
        out.extend(self.cells);
        seal(&mut out);
        out
    }
}

/// A stored form in the version that is written: as it is, or of what the version before says.
fn in_this_version(stored: &[u8]) -> Result<Cow<'_, [u8]>, SubmapBytesError> {
    if stored.get(VERSION_AT) == Some(&VERSION_BEFORE) {
        return Ok(Submap::decode(stored)?.encode().into());
    }
    Ok(stored.into())
}

/// What follows the checksum, which must be right.
fn checked(bytes: &[u8]) -> Result<Input<'_>, SubmapBytesError> {
    let mut input = Input(bytes);
    if input.take::<4>()? != MAGIC {
        return Err(SubmapBytesError::NotASubmap);
    }
    let [version] = input.take::<1>()?;
    if ![VERSION_BEFORE, VERSION].contains(&version) {
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

pub(crate) fn decode_levels(input: &mut Input<'_>) -> Result<Levels, SubmapBytesError> {
    let [count] = input.take::<1>()?;
    let mut levels = Levels::default();
    for _ in 0..count {
        if !levels.push(input.u16()?) {
            return Err(SubmapBytesError::Malformed);
        }
    }
    Ok(levels)
}

fn encode_keys(tiles: &[(TileKey, u64)], out: &mut Vec<u8>) {
    out.extend((tiles.len() as u32).to_le_bytes());
    let mut before = TileKey::default();
    for (TileKey { x, y }, _) in tiles.iter().copied() {
        encode_difference(before.x, x, out);
        encode_difference(before.y, y, out);
        before = TileKey { x, y };
    }
}

/// All up to the levels.
fn decode_outline(input: &mut Input<'_>, tiles_max: usize) -> Result<SubmapOutline, SubmapBytesError> {
    let emptied = decode_head(input)?;
    let keys = decode_keys(input, tiles_max, TILE_BYTES_MIN)?.into_iter();
    let blocks = keys.map(|key| Ok((key, input.u64()?))).collect::<Result<Vec<_>, _>>()?;
    Ok(SubmapOutline { emptied, blocks })
}

/// All up to the tiles: a submap without any.
pub(crate) fn decode_head(input: &mut Input<'_>) -> Result<Submap, SubmapBytesError> {
    let (number, trajectory, insertions) = (input.u32()?, input.u32()?, input.u32()?);
    let (first, last) = (input.u64()?, input.u64()?);
    let odom_from_submap = Pose { x_m: input.f64()?, y_m: input.f64()?, heading_rad: input.f64()? };
    let cell_size_m = input.f64()?;
    if !odom_from_submap.is_finite() || !(1e-3..=10.0).contains(&cell_size_m) || last < first {
        return Err(SubmapBytesError::Malformed);
    }
    let tiles = Vec::new();
    Ok(Submap { number, trajectory, insertions, first, last, odom_from_submap, cell_size_m, tiles })
}

pub(crate) fn decode_keys(
    input: &mut Input<'_>,
    tiles_max: usize,
    tile_bytes_min: usize,
) -> Result<Vec<TileKey>, SubmapBytesError> {
    let count = input.u32()?;
    if count as usize > tiles_max.min(TILES_MAX as usize) || count as usize > input.0.len() / tile_bytes_min {
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

fn encode_masks<'a>(masks: impl Iterator<Item = &'a Mask> + Clone, out: &mut Vec<u8>) {
    let rows = |mask: &Mask| {
        let bit = |(y, row): (usize, &u64)| u64::from(*row != 0) << y;
        mask.iter().enumerate().map(bit).sum::<u64>()
    };
    let cleared = masks.enumerate().filter(|(_, mask)| rows(mask) != 0);
    out.extend((cleared.clone().count() as u32).to_le_bytes());
    for (place, mask) in cleared {
        out.extend((place as u32).to_le_bytes());
        out.extend(rows(mask).to_le_bytes());
        mask.iter().filter(|row| **row != 0).for_each(|row| out.extend(row.to_le_bytes()));
    }
}

pub(crate) fn decode_masks(input: &mut Input<'_>, tiles: usize) -> Result<Vec<Mask>, SubmapBytesError> {
    let mut masks = vec![[0; TILE_SIDE]; tiles];
    let mut next = 0;
    for _ in 0..input.u32()? {
        let place = input.u32()? as usize;
        let rows = input.u64()?;
        let mask = masks.get_mut(place).filter(|_| place >= next && rows != 0);
        let mask = mask.ok_or(SubmapBytesError::Malformed)?;
        for (y, row) in mask.iter_mut().enumerate() {
            if rows >> y & 1 == 1 {
                *row = Some(input.u64()?).filter(|row| *row != 0).ok_or(SubmapBytesError::Malformed)?;
            }
        }
        next = place + 1;
    }
    Ok(masks)
}

/// Tiles at these places, with these masks, of which no cell is known.
pub(crate) fn unknown_tiles(keys: impl Iterator<Item = TileKey>, masks: Vec<Mask>) -> Vec<SubmapTile> {
    let unknown = |key| SubmapTile::new(key, Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
    keys.zip(masks).map(|(key, cleared)| SubmapTile { cleared, ..unknown(key) }).collect()
}

fn encode_cells(
    tiles: &[SubmapTile],
    blocks: &[(TileKey, u64)],
    levels: &CellLevels,
    out: Vec<u8>,
) -> Vec<u8> {
    let (mut coder, mut model) = (RangeEncoder::new(out), CellModel::new(levels));
    let mut symbols = [[0; 2]; TILE_CELLS];
    for (tile, (_, known)) in tiles.iter().zip(blocks) {
        for row in block_rows(*known) {
            for (symbol, cell) in symbols[row.clone()].iter_mut().zip(&tile.cells[row]) {
                *symbol = levels.places(*cell);
            }
        }
        model.code(&mut coder, *known, &mut symbols);
    }
    coder.finish()
}

fn decode_cells(
    bytes: &[u8],
    blocks: &[(TileKey, u64)],
    levels: &CellLevels,
    tiles: &mut [SubmapTile],
) -> Result<(), SubmapBytesError> {
    let (mut coder, mut model) = (RangeDecoder::new(bytes), CellModel::new(levels));
    let mut symbols: [Symbol; TILE_CELLS] = [[0; 2]; TILE_CELLS];
    for (tile, (_, known)) in tiles.iter_mut().zip(blocks) {
        model.code(&mut coder, *known, &mut symbols);
        if known_blocks(&symbols, |symbol| *symbol != [0; 2]) != *known {
            return Err(SubmapBytesError::Malformed);
        }
        for row in block_rows(*known) {
            for (cell, symbol) in tile.cells[row.clone()].iter_mut().zip(&symbols[row]) {
                *cell = levels.cell(*symbol).ok_or(SubmapBytesError::Malformed)?;
            }
        }
    }
    check_end(&coder, bytes)
}

/// That nothing of these bytes is left.
pub(crate) fn check_end(coder: &RangeDecoder<'_>, bytes: &[u8]) -> Result<(), SubmapBytesError> {
    // Zeros at the end are never written.
    match (coder.left(), bytes.last()) {
        (0, None | Some(1..)) => Ok(()),
        (left, _) => Err(SubmapBytesError::Trailing(left.max(1))),
    }
}

/// The bytes that are left to read.
pub(crate) struct Input<'a>(pub(crate) &'a [u8]);

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
pub(crate) mod tests;
