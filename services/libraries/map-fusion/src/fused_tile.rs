//! A tile of the fused map, which takes memory for the blocks of cells that something is known of.

use flockslam_evidence::{Cell, PackedCell, TILE_CELLS, TILE_SIDE};

/// Cells along a side of a block.
const BLOCK_SIDE: usize = 8;
/// Blocks along a side of a tile.
const BLOCKS_IN_ROW: usize = TILE_SIDE / BLOCK_SIDE;
/// Cells of a block.
const BLOCK_CELLS: usize = BLOCK_SIDE * BLOCK_SIDE;
/// The block has no cells yet.
const NONE: u8 = u8::MAX;
/// From this place on blocks are wide.
const WIDE: u8 = 64;
/// Memory for so many blocks is taken at a time.
const BLOCKS_AT_A_TIME: usize = 8;

/// Cells of a tile by their offset (y·64 + x). Those of a corridor fill a small part of the tiles around it. A block takes half the memory
/// as long as no sum in it is larger than the weight of one submap can be.
#[derive(Clone, Debug)]
pub struct FusedTile {
    /// By block, row by row: its place in `narrow`, or from [`WIDE`] on in `wide`, or [`NONE`].
    places: [u8; BLOCKS_IN_ROW * BLOCKS_IN_ROW],
    narrow: Vec<[PackedCell; BLOCK_CELLS]>,
    wide: Vec<[Cell; BLOCK_CELLS]>,
}

impl Default for FusedTile {
    fn default() -> Self {
        let places = [NONE; BLOCKS_IN_ROW * BLOCKS_IN_ROW];
        Self { places, narrow: Vec::new(), wide: Vec::new() }
    }
}

impl FusedTile {
    /// A cell.
    #[inline]
    pub fn cell(&self, offset: usize) -> Cell {
        let (block, place) = split(offset);
        match self.places[block] {
            NONE => Cell::UNKNOWN,
            at @ WIDE.. => self.wide[usize::from(at - WIDE)][place],
            at => self.narrow[usize::from(at)][place].unpack(),
        }
    }

    /// Puts a cell.
    #[inline]
    pub fn set_cell(&mut self, offset: usize, cell: Cell) {
        let (block, place) = split(offset);
        if self.places[block] == NONE {
            self.places[block] = self.another();
        }
        if let at @ ..WIDE = self.places[block] {
            if let Some(packed) = exactly(cell) {
                self.narrow[usize::from(at)][place] = packed;
                return;
            }
            self.widen(block);
        }
        self.wide[usize::from(self.places[block] - WIDE)][place] = cell;
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
        self.narrow.as_flattened().iter().all(|cell| cell.is_unknown())
            && self.wide.as_flattened().iter().all(|cell| cell.is_unknown())
    }

    /// Blocks with memory.
    #[cfg(test)]
    fn blocks(&self) -> usize {
        self.narrow.len() + self.wide.len()
    }

    #[cold]
    fn another(&mut self) -> u8 {
        if self.narrow.len() == self.narrow.capacity() {
            self.narrow.reserve_exact(BLOCKS_AT_A_TIME);
        }
        self.narrow.push([PackedCell::UNKNOWN; BLOCK_CELLS]);
        (self.narrow.len() - 1) as u8
    }

    /// Makes a narrow block wide; the last narrow one takes its place.
    #[cold]
    fn widen(&mut self, block: usize) {
        let at = self.places[block];
        let last = (self.narrow.len() - 1) as u8;
        let cells = self.narrow.swap_remove(usize::from(at)).map(PackedCell::unpack);
        if let Some(moved) = self.places.iter_mut().find(|place| **place == last) {
            *moved = at;
        }
        if self.wide.len() == self.wide.capacity() {
            self.wide.reserve_exact(BLOCKS_AT_A_TIME);
        }
        self.wide.push(cells);
        self.places[block] = WIDE + (self.wide.len() - 1) as u8;
    }
}

/// A cell in the form of one submap, where its weights are no larger.
#[inline]
fn exactly(cell: Cell) -> Option<PackedCell> {
    let packed = |weight: u32| u16::try_from(weight).ok();
    Some(PackedCell { occupied: packed(cell.occupied)?, free: packed(cell.free)? })
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
        (0..TILE_CELLS).filter(wall).for_each(|offset| tile.set_cell(offset, cell(offset)));
        let cells = tile.cells();
        for offset in 0..TILE_CELLS {
            let expected = if wall(&offset) { cell(offset) } else { Cell::UNKNOWN };
            assert_eq!((cells[offset], tile.cell(offset)), (expected, expected));
        }
        assert!(tile.blocks() < 40 && !tile.is_empty() && FusedTile::default().is_empty());
    }

    #[test]
    fn every_cell_has_a_place_of_its_own() {
        let mut tile = FusedTile::default();
        (0..TILE_CELLS)
            .for_each(|offset| tile.set_cell(offset, Cell { occupied: 0, free: 1 + offset as u32 }));
        assert!((0..TILE_CELLS).all(|offset| tile.cell(offset).free == 1 + offset as u32));
        assert_eq!(tile.blocks(), 64);
    }

    #[test]
    fn large_sums_are_as_exact_as_small_ones() {
        let mut tile = FusedTile::default();
        let sum = |offset: usize| Cell { occupied: (offset as u32 * 7919) % 131_072, free: offset as u32 };
        // Block by block becomes wide, in an order that is not theirs.
        for offset in (0..TILE_CELLS).map(|step| step * 1237 % TILE_CELLS) {
            tile.set_cell(offset, sum(offset));
        }
        assert!((0..TILE_CELLS).all(|offset| tile.cell(offset) == sum(offset)));
        assert_eq!(tile.blocks(), 64);
        (0..TILE_CELLS).for_each(|offset| tile.set_cell(offset, Cell::UNKNOWN));
        assert!(tile.is_empty());
    }
}
