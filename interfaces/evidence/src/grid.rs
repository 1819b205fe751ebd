//! The grid that scans are matched to: tiles by key, and fast reads of matching scores at three resolutions.

use crate::{CellIndex, PackedCell, Tile, TileDirectory, TileKey, TooFar};
use flockslam_geometry::Point;
use std::ops::Deref;

/// Resolution of the score pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// One score a cell.
    Full = 0,
    /// One score for 2 × 2 cells.
    Half = 1,
    /// One score for 4 × 4 cells.
    Quarter = 2,
}

/// A grid of evidence as its readers hold it: the newest version of each tile, wherever it is.
///
/// `H` gives access to a tile in place: a shared-memory sample between processes, `Box` or `Arc` in one process.
///
/// ```
/// use flockslam_evidence::{CellIndex, Level, PackedCell, Tile, TileGrid};
/// use flockslam_geometry::Point;
///
/// let mut grid: TileGrid<Box<Tile>> = TileGrid::new(0.05);
/// let wall = grid.cell_at(Point::new(1.02, 0.01));
/// assert_eq!(wall, CellIndex::new(20, 0));
/// let mut tile = Tile::unknown(0);
/// tile.cells[wall.offset()] = PackedCell { occupied: 900, free: 20 };
/// tile.set_score(wall.offset(), 60_000);
/// grid.set(wall.tile(), tile)?;
/// assert_eq!(grid.cell(wall).occupied, 900);
/// // A cell of the coarsest level has the greatest score of 4 × 4 cells.
/// assert_eq!(grid.score(Level::Quarter, CellIndex::new(5, 0)), 60_000);
/// # Ok::<(), flockslam_evidence::TooFar>(())
/// ```
#[derive(Clone, Debug)]
pub struct TileGrid<H> {
    cell_size_m: f64,
    tiles: TileDirectory<H>,
}

impl<H: Deref<Target = Tile>> TileGrid<H> {
    /// An empty grid with cells of this side.
    ///
    /// # Panics
    /// When the side is not a positive number.
    pub fn new(cell_size_m: f64) -> Self {
        assert!(cell_size_m.is_finite() && cell_size_m > 0.0, "cells of {cell_size_m} m");
        Self { cell_size_m, tiles: TileDirectory::default() }
    }

    /// Side of a cell, metres.
    #[inline]
    pub fn cell_size_m(&self) -> f64 {
        self.cell_size_m
    }

    /// Holds this version of a tile from now on and gives back the one before.
    ///
    /// # Errors
    /// When the tile is absurdly far from the others.
    pub fn set(&mut self, key: TileKey, tile: H) -> Result<Option<H>, TooFar> {
        self.tiles.set(key, tile)
    }

    /// Drops a tile.
    pub fn remove(&mut self, key: TileKey) -> Option<H> {
        self.tiles.remove(key)
    }

    /// A tile, if the grid has it.
    #[inline]
    pub fn tile(&self, key: TileKey) -> Option<&Tile> {
        self.tiles.get(key).map(|tile| &**tile)
    }

    /// Number of tiles held.
    pub fn len(&self) -> usize {
        self.tiles.len()
    }

    /// Whether no tile is held.
    pub fn is_empty(&self) -> bool {
        self.tiles.is_empty()
    }

    /// All tiles held, row by row.
    pub fn tiles(&self) -> impl Iterator<Item = (TileKey, &Tile)> {
        self.tiles.iter().map(|(key, tile)| (key, &**tile))
    }

    /// The cell that contains a point of the grid's frame.
    #[inline]
    pub fn cell_at(&self, point: Point) -> CellIndex {
        CellIndex::new(floor(point.x_m / self.cell_size_m), floor(point.y_m / self.cell_size_m))
    }

    /// Centre of a cell in the grid's frame.
    #[inline]
    pub fn center(&self, cell: CellIndex) -> Point {
        Point::new((f64::from(cell.x) + 0.5) * self.cell_size_m, (f64::from(cell.y) + 0.5) * self.cell_size_m)
    }

    /// Evidence of a cell; unknown where the grid has no tile.
    #[inline]
    pub fn cell(&self, cell: CellIndex) -> PackedCell {
        self.tile(cell.tile()).map_or(PackedCell::UNKNOWN, |tile| tile.cells[cell.offset()])
    }

    /// Matching score of a cell (0 … 65535 for 0 … 1) of a level, where `cell` counts cells of that level;
    /// 0 where the grid has no tile.
    #[inline]
    pub fn score(&self, level: Level, cell: CellIndex) -> u16 {
        self.scores(level, 0).cell(cell)
    }

    /// Fast repeated reads of one level; `outside` is the score where the grid has no tile.
    pub fn scores(&self, level: Level, outside: u16) -> ScoreReader<'_, H> {
        let shift = crate::TILE_SIDE.trailing_zeros() - level as u32;
        let corner = CellIndex::new(0, 0);
        let mut reader =
            ScoreReader { grid: self, level, shift, last: (1 << shift) - 1, outside, corner, scores: &[] };
        reader.turn_to(corner);
        reader
    }
}

/// Reads scores of one level; it keeps the last tile, since neighbouring beams end in the same one.
#[derive(Debug)]
pub struct ScoreReader<'a, H> {
    grid: &'a TileGrid<H>,
    level: Level,
    /// A tile of this level has 2 to this power cells along a side.
    shift: u32,
    /// Last column and row of a tile.
    last: u32,
    outside: u16,
    /// First cell of the cached tile.
    corner: CellIndex,
    /// Its scores; empty where the grid has no tile.
    scores: &'a [u16],
}

impl<'a, H: Deref<Target = Tile>> ScoreReader<'a, H> {
    /// Side of a cell of this level, metres.
    pub fn cell_size_m(&self) -> f64 {
        self.grid.cell_size_m * f64::from(1u8 << self.level as u32)
    }

    /// Score of a cell of this level.
    #[inline]
    pub fn cell(&mut self, cell: CellIndex) -> u16 {
        let (mut x, mut y) = self.place(cell);
        if x > self.last || y > self.last {
            self.turn_to(cell);
            (x, y) = self.place(cell);
        }
        self.scores.get((y << self.shift | x) as usize).copied().unwrap_or(self.outside)
    }

    /// Scores of the cells of a row, from `first` on to the right.
    pub fn row(&mut self, first: CellIndex, scores: &mut [u16]) {
        let (mut cell, mut left) = (first, scores);
        while !left.is_empty() {
            self.turn_to(cell);
            let (x, y) = self.place(cell);
            let count = left.len().min((self.last - x) as usize + 1);
            let (here, further) = left.split_at_mut(count);
            let start = (y << self.shift | x) as usize;
            match self.scores.get(start..start + count) {
                Some(known) => here.copy_from_slice(known),
                None => here.fill(self.outside),
            }
            cell.x = cell.x.wrapping_add(count as i32);
            left = further;
        }
    }

    /// Scores of the block whose lower left cell is given: (0, 0), (1, 0), (0, 1), (1, 1).
    #[inline]
    pub fn block(&mut self, cell: CellIndex) -> [u16; 4] {
        let (x, y) = self.place(cell);
        if x < self.last && y < self.last {
            return self.block_within(x, y);
        }
        self.block_of_other_tile(cell)
    }

    /// A block that is in the cached tile.
    #[inline]
    fn block_within(&self, x: u32, y: u32) -> [u16; 4] {
        let pair = |y: u32| self.scores.get((y << self.shift | x) as usize..)?.first_chunk::<2>();
        match (pair(y), pair(y.wrapping_add(1))) {
            (Some(&[m00, m10]), Some(&[m01, m11])) => [m00, m10, m01, m11],
            _ => [self.outside; 4],
        }
    }

    /// A block of another tile than the cached one, or of several.
    #[cold]
    #[inline(never)]
    fn block_of_other_tile(&mut self, cell: CellIndex) -> [u16; 4] {
        self.turn_to(cell);
        let (x, y) = self.place(cell);
        if x < self.last && y < self.last {
            return self.block_within(x, y);
        }
        let (right, up) = (cell.x.wrapping_add(1), cell.y.wrapping_add(1));
        let other = |x, y| {
            let cell = CellIndex::new(x, y);
            self.scores_at(cell).get(self.offset(cell)).copied().unwrap_or(self.outside)
        };
        [other(cell.x, cell.y), other(right, cell.y), other(cell.x, up), other(right, up)]
    }

    /// Column and row of a cell in the cached tile; cells of other tiles get numbers above `last`.
    #[inline]
    fn place(&self, cell: CellIndex) -> (u32, u32) {
        (cell.x.wrapping_sub(self.corner.x) as u32, cell.y.wrapping_sub(self.corner.y) as u32)
    }

    /// Place of a cell's score in its tile.
    #[inline]
    fn offset(&self, cell: CellIndex) -> usize {
        ((cell.y as u32 & self.last) << self.shift | cell.x as u32 & self.last) as usize
    }

    /// Caches the tile of a cell.
    fn turn_to(&mut self, cell: CellIndex) {
        self.corner = CellIndex::new(cell.x & !(self.last as i32), cell.y & !(self.last as i32));
        self.scores = self.scores_at(cell);
    }

    /// Scores of the tile that a cell is in.
    fn scores_at(&self, cell: CellIndex) -> &'a [u16] {
        let tile = self.grid.tile(TileKey { x: cell.x >> self.shift, y: cell.y >> self.shift });
        tile.map_or(&[], |tile| match self.level {
            Level::Full => &tile.score[..],
            Level::Half => &tile.score_half[..],
            Level::Quarter => &tile.score_quarter[..],
        })
    }
}

/// Greatest whole number not above `value`, saturating. (The target's baseline has no instruction for it, so the
/// library's `floor` would be a call.)
#[inline]
pub fn floor(value: f64) -> i32 {
    let truncated = value as i32;
    truncated.saturating_sub(i32::from(value < f64::from(truncated)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid() -> TileGrid<Box<Tile>> {
        let mut grid = TileGrid::new(0.05);
        for (x, y) in [(0, 0), (-1, 0), (0, -1)] {
            let mut tile = Tile::unknown(0);
            for offset in 0..crate::TILE_CELLS {
                tile.set_score(
                    offset,
                    (offset as u16).wrapping_mul(40_503) ^ (x as u16).wrapping_mul(257) ^ y as u16,
                );
            }
            grid.set(TileKey { x, y }, tile).unwrap();
        }
        grid
    }

    proptest! {
        #[test]
        fn blocks_and_single_cells_agree_across_tiles(x in -70i32..70, y in -70i32..70, level in 0usize..3) {
            let (grid, level) = (grid(), [Level::Full, Level::Half, Level::Quarter][level]);
            let block = grid.scores(level, 7).block(CellIndex::new(x, y));
            for (i, score) in block.into_iter().enumerate() {
                let cell = CellIndex::new(x + (i % 2) as i32, y + (i / 2) as i32);
                prop_assert_eq!(score, grid.scores(level, 7).cell(cell));
            }
        }

        #[test]
        fn rows_and_single_cells_agree(x in -150i32..150, y in -70i32..70, count in 0usize..200, level in 0usize..3) {
            let (grid, level) = (grid(), [Level::Full, Level::Half, Level::Quarter][level]);
            let mut row = vec![1; count];
            grid.scores(level, 7).row(CellIndex::new(x, y), &mut row);
            for (cell, score) in (x..).zip(row) {
                prop_assert_eq!(score, grid.scores(level, 7).cell(CellIndex::new(cell, y)));
            }
        }

        #[test]
        fn floor_is_floor(value in -1e9..1e9f64) {
            prop_assert_eq!(f64::from(floor(value)), value.floor());
        }
    }

    #[test]
    fn a_point_lies_in_the_cell_whose_center_is_near() {
        let grid = grid();
        let cell = grid.cell_at(Point::new(-0.01, 0.26));
        assert_eq!(cell, CellIndex::new(-1, 5));
        assert!(grid.center(cell).distance_m(Point::new(-0.025, 0.275)) < 1e-12);
        assert_eq!(grid.score(Level::Full, CellIndex::new(1000, 0)), 0);
        assert!(grid.cell(CellIndex::new(1000, 0)).is_unknown());
    }
}
