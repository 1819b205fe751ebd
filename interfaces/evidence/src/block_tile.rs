//! A tile of cells that takes memory for the blocks that something is known of.

use crate::{Cell, PackedCell, TILE_CELLS, TILE_SIDE};

/// Cells along a side of a block.
pub(crate) const BLOCK_SIDE: usize = 8;
/// Blocks along a side of a tile.
const BLOCKS_IN_ROW: usize = TILE_SIDE / BLOCK_SIDE;
/// Cells of a block.
const BLOCK_CELLS: usize = BLOCK_SIDE * BLOCK_SIDE;
/// The block has no cells yet.
const NONE: u8 = u8::MAX;
/// From this place on blocks are narrow, below they are free.
const NARROW: u8 = 64;
/// From this place on blocks are wide.
const WIDE: u8 = 128;
/// Memory for so many blocks is taken at a time.
const BLOCKS_AT_A_TIME: usize = 2;

/// Cells of a tile by their offset (y·64 + x). Those of a corridor fill a small part of the tiles around it.
///
/// A block takes a quarter of the memory while there is evidence for "free" alone in it, and half as long as no sum is larger than the
/// weight of one submap can be.
#[derive(Clone, Debug)]
pub struct BlockTile {
    /// By block, row by row: its place in `free`, from [`NARROW`] on in `narrow`, from [`WIDE`] on in `wide`, or [`NONE`].
    places: [u8; BLOCKS_IN_ROW * BLOCKS_IN_ROW],
    /// Evidence for "free" of blocks that have no other.
    free: Vec<[u16; BLOCK_CELLS]>,
    narrow: Vec<[PackedCell; BLOCK_CELLS]>,
    wide: Vec<[Cell; BLOCK_CELLS]>,
}

impl Default for BlockTile {
    fn default() -> Self {
        let places = [NONE; BLOCKS_IN_ROW * BLOCKS_IN_ROW];
        Self { places, free: Vec::new(), narrow: Vec::new(), wide: Vec::new() }
    }
}

impl BlockTile {
    /// A tile of these cells.
    pub fn of(cells: &[PackedCell; TILE_CELLS]) -> Self {
        let mut tile = Self::default();
        for block in 0..tile.places.len() {
            let corner = corner(block);
            let of_block = std::array::from_fn::<_, BLOCK_CELLS, _>(|place| {
                cells[corner + place / BLOCK_SIDE * TILE_SIDE + place % BLOCK_SIDE]
            });
            let all = of_block.iter().fold([0; 2], |all, cell| [all[0] | cell.occupied, all[1] | cell.free]);
            tile.places[block] = match all {
                [0, 0] => NONE,
                [0, _] => take_place(&mut tile.free, of_block.map(|cell| cell.free)),
                _ => NARROW + take_place(&mut tile.narrow, of_block),
            };
        }
        tile
    }

    /// A cell.
    #[inline]
    pub fn cell(&self, offset: usize) -> Cell {
        let (block, place) = split(offset);
        match self.places[block] {
            NONE => Cell::UNKNOWN,
            at @ WIDE.. => self.wide[usize::from(at - WIDE)][place],
            at @ NARROW.. => self.narrow[usize::from(at - NARROW)][place].unpack(),
            at => Cell { occupied: 0, free: u32::from(self.free[usize::from(at)][place]) },
        }
    }

    /// Puts a cell.
    #[inline]
    pub fn set_cell(&mut self, offset: usize, cell: Cell) {
        let (block, place) = split(offset);
        let packed = exactly(cell);
        if self.places[block] == NONE {
            self.places[block] = take_place(&mut self.free, [0; BLOCK_CELLS]);
        }
        if let at @ ..NARROW = self.places[block] {
            if let Some(PackedCell { occupied: 0, free }) = packed {
                self.free[usize::from(at)][place] = free;
                return;
            }
            let cells = leave_place(&mut self.free, at, &mut self.places, 0);
            let cells = cells.map(|free| PackedCell { occupied: 0, free });
            self.places[block] = NARROW + take_place(&mut self.narrow, cells);
        }
        if let at @ ..WIDE = self.places[block] {
            if let Some(packed) = packed {
                self.narrow[usize::from(at - NARROW)][place] = packed;
                return;
            }
            let cells = leave_place(&mut self.narrow, at, &mut self.places, NARROW);
            self.places[block] = WIDE + take_place(&mut self.wide, cells.map(PackedCell::unpack));
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
    pub fn copy_row(&self, y: usize, mut from: usize, mut cells: &mut [Cell]) {
        while from < TILE_SIDE && !cells.is_empty() {
            let row = self.row_of_block(y / BLOCK_SIDE * BLOCKS_IN_ROW + from / BLOCK_SIDE, y % BLOCK_SIDE);
            let row = &row[from % BLOCK_SIDE..];
            let (here, rest) = cells.split_at_mut(row.len().min(cells.len()));
            here.copy_from_slice(&row[..here.len()]);
            (from, cells) = (from + here.len(), rest);
        }
    }

    /// The cells with evidence and their offsets, block by block.
    pub fn known(&self) -> impl Iterator<Item = (usize, Cell)> {
        let blocks = (0..self.places.len()).filter(|block| self.places[*block] != NONE);
        let rows = blocks.flat_map(|block| (0..BLOCK_SIDE).map(move |row| (block, row)));
        let cells = rows
            .flat_map(|(block, row)| (corner(block) + row * TILE_SIDE..).zip(self.row_of_block(block, row)));
        cells.filter(|(_, cell)| !cell.is_unknown())
    }

    /// The eight cells of a row of a block.
    #[inline]
    fn row_of_block(&self, block: usize, row: usize) -> [Cell; BLOCK_SIDE] {
        let start = row * BLOCK_SIDE;
        match self.places[block] {
            NONE => [Cell::UNKNOWN; BLOCK_SIDE],
            at @ WIDE.. => std::array::from_fn(|x| self.wide[usize::from(at - WIDE)][start + x]),
            at @ NARROW.. => {
                std::array::from_fn(|x| self.narrow[usize::from(at - NARROW)][start + x].unpack())
            }
            at => std::array::from_fn(|x| Cell {
                occupied: 0,
                free: u32::from(self.free[usize::from(at)][start + x]),
            }),
        }
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.free.as_flattened().iter().all(|free| *free == 0)
            && self.narrow.as_flattened().iter().all(|cell| cell.is_unknown())
            && self.wide.as_flattened().iter().all(|cell| cell.is_unknown())
    }

    /// Memory of its blocks, bytes.
    #[cfg(test)]
    fn bytes(&self) -> usize {
        size_of_val(&self.free[..]) + size_of_val(&self.narrow[..]) + size_of_val(&self.wide[..])
    }
}

/// Adds a block; gives its place.
#[cold]
fn take_place<T>(blocks: &mut Vec<T>, block: T) -> u8 {
    if blocks.len() == blocks.capacity() {
        blocks.reserve_exact(BLOCKS_AT_A_TIME);
    }
    blocks.push(block);
    (blocks.len() - 1) as u8
}

/// Removes the block at `at` from those whose places begin at `first`; the last of them takes its place.
#[cold]
fn leave_place<T>(blocks: &mut Vec<T>, at: u8, places: &mut [u8], first: u8) -> T {
    let last = first + (blocks.len() - 1) as u8;
    if let Some(moved) = places.iter_mut().find(|place| **place == last) {
        *moved = at;
    }
    let left = blocks.swap_remove(usize::from(at - first));
    // Room that evidence of another kind will not need again: most blocks leave once.
    if blocks.capacity() - blocks.len() > BLOCKS_AT_A_TIME {
        blocks.shrink_to_fit();
    }
    left
}

/// A cell in the form of one submap, where its weights are no larger.
#[inline]
fn exactly(cell: Cell) -> Option<PackedCell> {
    let packed = |weight: u32| u16::try_from(weight).ok();
    Some(PackedCell { occupied: packed(cell.occupied)?, free: packed(cell.free)? })
}

/// The offset of the first cell of a block.
pub(crate) fn corner(block: usize) -> usize {
    block / BLOCKS_IN_ROW * BLOCK_SIDE * TILE_SIDE + block % BLOCKS_IN_ROW * BLOCK_SIDE
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

    const FREE_BLOCK_BYTES: usize = 128;

    #[test]
    fn cells_are_where_they_were_put_and_the_others_take_no_memory() {
        let mut tile = BlockTile::default();
        let cell = |number: usize| Cell { occupied: number as u32, free: 1 };
        let wall = |offset: &usize| (100..140).contains(&(offset % 64 * 2 + offset / 64));
        (0..TILE_CELLS).filter(wall).for_each(|offset| tile.set_cell(offset, cell(offset)));
        let cells = tile.cells();
        for offset in 0..TILE_CELLS {
            let expected = if wall(&offset) { cell(offset) } else { Cell::UNKNOWN };
            assert_eq!((cells[offset], tile.cell(offset)), (expected, expected));
        }
        let again = BlockTile::of(&cells.map(Cell::pack));
        assert_eq!((again.cells(), again.bytes()), (cells.clone(), tile.bytes()));
        let mut known: Vec<_> = tile.known().collect();
        known.sort_by_key(|(offset, _)| *offset);
        assert!(known.into_iter().eq((0..TILE_CELLS).filter(wall).map(|offset| (offset, cell(offset)))));
        for (y, from, count) in [(9, 0, TILE_SIDE), (30, 13, 30), (63, 63, 1), (0, 60, 4)] {
            let mut row = vec![Cell::UNKNOWN; count];
            tile.copy_row(y, from, &mut row);
            assert_eq!(row, cells[y * TILE_SIDE + from..][..count]);
        }
        assert!(
            tile.bytes() < 40 * 2 * FREE_BLOCK_BYTES && !tile.is_empty() && BlockTile::default().is_empty()
        );
    }

    #[test]
    fn free_cells_take_two_bytes_and_each_has_a_place_of_its_own() {
        let mut tile = BlockTile::default();
        (0..TILE_CELLS)
            .for_each(|offset| tile.set_cell(offset, Cell { occupied: 0, free: 1 + offset as u32 }));
        assert!((0..TILE_CELLS).all(|offset| tile.cell(offset).free == 1 + offset as u32));
        assert_eq!(tile.bytes(), 64 * FREE_BLOCK_BYTES);
        tile.set_cell(77, Cell { occupied: 5, free: 3 });
        assert_eq!(tile.bytes(), 65 * FREE_BLOCK_BYTES);
        let expected = |offset| match offset {
            77 => Cell { occupied: 5, free: 3 },
            _ => Cell { occupied: 0, free: 1 + offset as u32 },
        };
        assert!((0..TILE_CELLS).all(|offset| tile.cell(offset) == expected(offset)));
    }

    #[test]
    fn large_sums_are_as_exact_as_small_ones() {
        let mut tile = BlockTile::default();
        let sum = |offset: usize| Cell { occupied: (offset as u32 * 7919) % 131_072, free: offset as u32 };
        // Block by block becomes wide, in an order that is not theirs.
        for offset in (0..TILE_CELLS).map(|step| step * 1237 % TILE_CELLS) {
            tile.set_cell(offset, sum(offset));
        }
        assert!((0..TILE_CELLS).all(|offset| tile.cell(offset) == sum(offset)));
        assert_eq!(tile.bytes(), 64 * 4 * FREE_BLOCK_BYTES);
        (0..TILE_CELLS).for_each(|offset| tile.set_cell(offset, Cell::UNKNOWN));
        assert!(tile.is_empty());
    }
}
