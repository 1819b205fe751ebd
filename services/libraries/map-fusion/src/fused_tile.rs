//! A tile of the fused map, which takes memory for the blocks of cells that something is known of.

use flockslam_evidence::{Cell, TILE_CELLS, TILE_SIDE};

/// Cells along a side of a block.
const BLOCK_SIDE: usize = 8;
/// Blocks along a side of a tile.
const BLOCKS_IN_ROW: usize = TILE_SIDE / BLOCK_SIDE;
/// Cells of a block.
const BLOCK_CELLS: usize = BLOCK_SIDE * BLOCK_SIDE;
/// The block has no cells yet.
const NONE: u8 = u8::MAX;
/// Memory for so many blocks is taken at a time.
const BLOCKS_AT_A_TIME: usize = 8;

/// Cells of a tile by their offset (y·64 + x). Those of a corridor fill a small part of the tiles around it.
#[derive(Clone, Debug)]
pub struct FusedTile {
    /// By block, row by row: its place in `blocks`, or [`NONE`].
    places: [u8; BLOCKS_IN_ROW * BLOCKS_IN_ROW],
    blocks: Vec<[Cell; BLOCK_CELLS]>,
}

impl Default for FusedTile {
    fn default() -> Self {
        Self { places: [NONE; BLOCKS_IN_ROW * BLOCKS_IN_ROW], blocks: Vec::new() }
    }
}

impl FusedTile {
    /// A cell.
    #[inline]
    pub fn cell(&self, offset: usize) -> Cell {
        let (block, place) = split(offset);
        self.blocks.get(usize::from(self.places[block])).map_or(Cell::UNKNOWN, |cells| cells[place])
    }

    /// A cell, to change it.
    #[inline]
    pub fn cell_mut(&mut self, offset: usize) -> &mut Cell {
        let (block, place) = split(offset);
        if self.places[block] == NONE {
            self.places[block] = self.another();
        }
        &mut self.blocks[usize::from(self.places[block])][place]
    }

    /// All cells.
    pub fn cells(&self) -> Box<[Cell; TILE_CELLS]> {
        let mut cells = Box::new([Cell::UNKNOWN; TILE_CELLS]);
        for (y, row) in cells.chunks_exact_mut(TILE_SIDE).enumerate() {
            self.copy_row(y, 0, row);
        }
        cells
    }

    /// Copies the cells of row `y` from column `from` on.
    pub fn copy_row(&self, y: usize, from: usize, cells: &mut [Cell]) {
        for (x, cell) in (from..TILE_SIDE).zip(cells) {
            *cell = self.cell(y * TILE_SIDE + x);
        }
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.blocks.as_flattened().iter().all(|cell| cell.is_unknown())
    }

    #[cold]
    fn another(&mut self) -> u8 {
        if self.blocks.len() == self.blocks.capacity() {
            self.blocks.reserve_exact(BLOCKS_AT_A_TIME);
        }
        self.blocks.push([Cell::UNKNOWN; BLOCK_CELLS]);
        (self.blocks.len() - 1) as u8
    }
}

/// The block of a cell, and the place of the cell in it.
#[inline]
fn split(offset: usize) -> (usize, usize) {
    let (x, y) = (offset % TILE_SIDE, offset / TILE_SIDE);
    (y / BLOCK_SIDE * BLOCKS_IN_ROW + x / BLOCK_SIDE, y % BLOCK_SIDE * BLOCK_SIDE + x % BLOCK_SIDE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_where_they_were_put_and_the_others_take_no_memory() {
        let mut tile = FusedTile::default();
        let cell = |number: usize| Cell { occupied: number as u32, free: 1 };
        let wall = |offset: &usize| (100..140).contains(&(offset % 64 * 2 + offset / 64));
        (0..TILE_CELLS).filter(wall).for_each(|offset| *tile.cell_mut(offset) = cell(offset));
        let cells = tile.cells();
        for offset in 0..TILE_CELLS {
            let expected = if wall(&offset) { cell(offset) } else { Cell::UNKNOWN };
            assert_eq!((cells[offset], tile.cell(offset)), (expected, expected));
        }
        assert!(tile.blocks.len() < 40 && !tile.is_empty() && FusedTile::default().is_empty());
    }

    #[test]
    fn every_cell_has_a_place_of_its_own() {
        let mut tile = FusedTile::default();
        (0..TILE_CELLS).for_each(|offset| tile.cell_mut(offset).free = 1 + offset as u32);
        assert!((0..TILE_CELLS).all(|offset| tile.cell(offset).free == 1 + offset as u32));
        assert_eq!(tile.blocks.len(), 64);
    }
}
