//! Dempster–Shafer evidence for occupancy mapping: cells, tiles, grids, submaps, fusion and read-outs. No I/O.

mod cell;
mod tile;

pub use cell::{Cell, Masses, PackedCell, WEIGHT_SCALE};
pub use tile::{TILE_CELLS, TILE_SIDE, Tile, TileKey};
