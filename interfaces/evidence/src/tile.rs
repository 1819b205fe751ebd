use crate::PackedCell;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Cells along one side of a tile.
pub const TILE_SIDE: usize = 64;
/// Cells in a tile.
pub const TILE_CELLS: usize = TILE_SIDE * TILE_SIDE;

/// Which tile of the plane: cell (i, j) lies in tile (i div 64, j div 64), with floor division.
#[repr(C)]
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, FromBytes, IntoBytes, Immutable, KnownLayout,
)]
pub struct TileKey {
    /// Column of tiles.
    pub x: i32,
    /// Row of tiles.
    pub y: i32,
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
