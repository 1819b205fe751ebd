//! Tiles: blocks of 64 × 64 cells with their matching scores, and the indices of cells and tiles.

use crate::PackedCell;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Cells along one side of a tile.
pub const TILE_SIDE: usize = 64;
/// Cells in a tile.
pub const TILE_CELLS: usize = TILE_SIDE * TILE_SIDE;

const SIDE_SHIFT: u32 = TILE_SIDE.trailing_zeros();
const SIDE_MASK: i32 = TILE_SIDE as i32 - 1;

/// Which tile of the plane: cell (i, j) is in tile (i div 64, j div 64), with floor division.
#[repr(C)]
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    FromBytes,
    IntoBytes,
    Immutable,
    KnownLayout,
)]
pub struct TileKey {
    /// Column of tiles.
    pub x: i32,
    /// Row of tiles.
    pub y: i32,
}

/// Index of a cell in an unbounded lattice: cell (i, j) covers `[i·s, (i+1)·s) × [j·s, (j+1)·s)` metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CellIndex {
    /// Column of cells.
    pub x: i32,
    /// Row of cells.
    pub y: i32,
}

impl CellIndex {
    /// The cell (x, y).
    #[inline]
    pub const fn new(x: i32, y: i32) -> Self {
        Self { x, y }
    }

    /// The tile it is in.
    #[inline]
    pub const fn tile(self) -> TileKey {
        TileKey { x: self.x >> SIDE_SHIFT, y: self.y >> SIDE_SHIFT }
    }

    /// Its place in that tile, `0 .. TILE_CELLS`.
    #[inline]
    pub const fn offset(self) -> usize {
        (((self.y & SIDE_MASK) << SIDE_SHIFT) | (self.x & SIDE_MASK)) as usize
    }
}

impl TileKey {
    /// The cell at `offset` (`0 .. TILE_CELLS`) of this tile. Columns beyond the range of `i32` wrap.
    pub const fn cell(self, offset: usize) -> CellIndex {
        let (column, row) = (offset as i32 & SIDE_MASK, offset as i32 >> SIDE_SHIFT);
        CellIndex { x: self.x.wrapping_shl(SIDE_SHIFT) | column, y: self.y.wrapping_shl(SIDE_SHIFT) | row }
    }
}

/// 64 × 64 cells, row by row (index = y·64 + x), with the smooth score that matchers read beside the evidence.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct Tile {
    /// The evidence.
    pub cells: [PackedCell; TILE_CELLS],
    /// Matching score of each cell, 0 … 65535 for 0 … 1.
    pub score: [u16; TILE_CELLS],
    /// Greatest score of each 2 × 2 block of `score` (32 × 32, row by row).
    pub score_half: [u16; TILE_CELLS / 4],
    /// Greatest score of each 2 × 2 block of `score_half` (16 × 16, row by row).
    pub score_quarter: [u16; TILE_CELLS / 16],
}

impl Tile {
    /// A tile without evidence whose scores are all `unknown_score`.
    pub fn unknown(unknown_score: u16) -> Box<Tile> {
        Box::new(Tile {
            cells: [PackedCell::UNKNOWN; TILE_CELLS],
            score: [unknown_score; TILE_CELLS],
            score_half: [unknown_score; TILE_CELLS / 4],
            score_quarter: [unknown_score; TILE_CELLS / 16],
        })
    }

    /// Sets the score of the cell at `offset` and what follows from it in the coarser levels.
    #[inline]
    pub fn set_score(&mut self, offset: usize, score: u16) {
        let before = std::mem::replace(&mut self.score[offset], score);
        let (x, y) = (offset & (TILE_SIDE - 1), offset >> SIDE_SHIFT);
        let half = &mut self.score_half[(y / 2) * (TILE_SIDE / 2) + x / 2];
        let pooled = if score >= *half {
            score
        } else if before == *half {
            greatest_of_block(&self.score, TILE_SIDE, x / 2, y / 2)
        } else {
            // Another cell of the block is the greatest, as before.
            return;
        };
        let before = std::mem::replace(half, pooled);
        let quarter = &mut self.score_quarter[(y / 4) * (TILE_SIDE / 4) + x / 4];
        if pooled >= *quarter {
            *quarter = pooled;
        } else if before == *quarter {
            *quarter = greatest_of_block(&self.score_half, TILE_SIDE / 2, x / 4, y / 4);
        }
    }
}

/// Greatest of the 2 × 2 block (x, y) of a square of `side` numbers.
fn greatest_of_block(scores: &[u16], side: usize, x: usize, y: usize) -> u16 {
    let first = 2 * y * side + 2 * x;
    scores[first].max(scores[first + 1]).max(scores[first + side]).max(scores[first + side + 1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn cells_and_tiles_are_two_names_for_the_same_place(x in any::<i32>(), y in any::<i32>()) {
            let cell = CellIndex::new(x, y);
            prop_assert_eq!(cell.tile().cell(cell.offset()), cell);
            prop_assert_eq!(cell.tile().x, x.div_euclid(TILE_SIDE as i32));
            prop_assert_eq!(cell.tile().y, y.div_euclid(TILE_SIDE as i32));
            prop_assert!(cell.offset() < TILE_CELLS);
        }

        #[test]
        fn coarser_levels_hold_the_greatest_score(
            edits in proptest::collection::vec((0..TILE_CELLS, any::<u16>()), 1..200)
        ) {
            let mut tile = Tile::unknown(0);
            for (offset, score) in edits {
                tile.set_score(offset, score);
            }
            for half in 0..TILE_CELLS / 4 {
                let (x, y) = (half % 32, half / 32);
                let best = (0..4).map(|i| tile.score[(2 * y + i / 2) * 64 + 2 * x + i % 2]).max().unwrap();
                prop_assert_eq!(tile.score_half[half], best);
            }
            for quarter in 0..TILE_CELLS / 16 {
                let (x, y) = (quarter % 16, quarter / 16);
                let best = (0..16).map(|i| tile.score[(4 * y + i / 4) * 64 + 4 * x + i % 4]).max().unwrap();
                prop_assert_eq!(tile.score_quarter[quarter], best);
            }
        }
    }
}
