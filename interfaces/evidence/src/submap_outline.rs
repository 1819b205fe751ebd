//! A submap without its evidence: where it knows something.

use crate::block_tile::{BLOCK_SIDE, corner};
use crate::{PackedCell, Submap, SubmapTile, TILE_CELLS, TILE_SIDE, TileKey};
use std::ops::Range;

/// A submap without its evidence, in which blocks of 8 × 8 cells it has some. Once a submap is closed this never changes: cleared cells
/// count. It is read from the stored form without the cells.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapOutline {
    /// The submap without its tiles.
    pub emptied: Submap,
    /// Its tiles in ascending order, each with the blocks that have evidence (bit = row of blocks · 8 + column).
    pub blocks: Vec<(TileKey, u64)>,
}

impl SubmapOutline {
    /// That of a submap.
    pub fn of(submap: &Submap) -> Self {
        let Submap { number, trajectory, insertions, first, last, odom_from_submap, cell_size_m, .. } =
            *submap;
        let tiles = Vec::new();
        Self {
            emptied: Submap {
                number,
                trajectory,
                insertions,
                first,
                last,
                odom_from_submap,
                cell_size_m,
                tiles,
            },
            blocks: submap.tiles.iter().map(|tile| (tile.key, tile.known_blocks())).collect(),
        }
    }
}

impl SubmapTile {
    /// The blocks of 8 × 8 cells that have evidence, cleared or not (bit = row of blocks · 8 + column).
    pub fn known_blocks(&self) -> u64 {
        known_blocks(&self.cells, |cell: &PackedCell| !cell.is_unknown())
    }
}

/// The blocks of 8 × 8 cells of a tile with a cell that is known.
pub(crate) fn known_blocks<T>(cells: &[T; TILE_CELLS], is_known: impl Fn(&T) -> bool) -> u64 {
    let mut blocks = 0;
    for (y, row) in cells.as_chunks::<TILE_SIDE>().0.iter().enumerate() {
        for (x, cells) in row.as_chunks::<BLOCK_SIDE>().0.iter().enumerate() {
            let any = cells.iter().fold(false, |any, cell| any | is_known(cell));
            blocks |= u64::from(any) << (y / BLOCK_SIDE * BLOCK_SIDE + x);
        }
    }
    blocks
}

/// The rows of eight cells that these blocks of a tile consist of, as ranges of offsets.
pub(crate) fn block_rows(blocks: u64) -> impl Iterator<Item = Range<usize>> {
    let blocks = (0..TILE_SIDE).filter(move |block| blocks >> block & 1 == 1);
    blocks.flat_map(|block| {
        let start = move |row| corner(block) + row * TILE_SIDE;
        (0..BLOCK_SIDE).map(move |row| start(row)..start(row) + BLOCK_SIDE)
    })
}
