//! Reads the stored form of a submap that builds before version 3 wrote: the levels stood before the tiles, and which blocks have evidence
//! was coded among the cells.

use crate::cell_coder::{CHUNK, CellModel, Symbol};
use crate::range_coder::{BinaryCoder, Likelihood, RangeDecoder};
use crate::submap_bytes::{
    Input, KEY_BYTES_MIN, SubmapBytesError, check_end, decode_head, decode_keys, decode_levels, decode_masks,
    unknown_tiles,
};
use crate::weight_levels::CellLevels;
use crate::{Submap, SubmapTile, TILE_CELLS, TILE_SIDE};

/// Blocks of a row of blocks.
const BLOCKS: usize = TILE_SIDE / CHUNK;

/// What follows the checksum.
///
/// # Errors
/// When it is not exactly one well-formed submap of at most so many tiles.
pub fn decode(mut input: Input<'_>, tiles_max: usize) -> Result<Submap, SubmapBytesError> {
    let head = decode_head(&mut input)?;
    let levels = CellLevels { occupied: decode_levels(&mut input)?, free: decode_levels(&mut input)? };
    let keys = decode_keys(&mut input, tiles_max, KEY_BYTES_MIN)?;
    let masks = decode_masks(&mut input, keys.len())?;
    let mut tiles = unknown_tiles(keys.into_iter(), masks);
    decode_cells(input.0, &levels, &mut tiles)?;
    Ok(Submap { tiles, ..head })
}

fn decode_cells(bytes: &[u8], levels: &CellLevels, tiles: &mut [SubmapTile]) -> Result<(), SubmapBytesError> {
    let (mut coder, mut model) = (RangeDecoder::new(bytes), CellModel::of_version_2(levels));
    let mut is_empty = Default::default();
    let mut symbols: [Symbol; TILE_CELLS] = [[0; 2]; TILE_CELLS];
    for tile in tiles {
        let (mut below, mut blocks) = ([[0; 2]; TILE_SIDE], 0);
        for rows in symbols.chunks_mut(TILE_SIDE * CHUNK) {
            blocks = decode_blocks(&mut coder, &mut is_empty, blocks);
            model.code_rows(&mut coder, blocks, rows, &mut below);
        }
        for (cell, symbol) in tile.cells.iter_mut().zip(&symbols).filter(|(_, symbol)| **symbol != [0; 2]) {
            *cell = levels.cell(*symbol).ok_or(SubmapBytesError::Malformed)?;
        }
    }
    check_end(&coder, bytes)
}

/// Which blocks of a row of blocks have evidence, one bit each, in the context of the row below and of the block to the left.
fn decode_blocks(coder: &mut RangeDecoder<'_>, is_empty: &mut [Likelihood; 4], below: u8) -> u8 {
    (0..BLOCKS).fold(0, |blocks, block| {
        let left_is_empty = block == 0 || blocks >> (block - 1) & 1 == 0;
        let context = usize::from(below >> block & 1 == 0) + 2 * usize::from(left_is_empty);
        blocks | u8::from(!coder.code(&mut is_empty[context], false)) << block
    })
}
