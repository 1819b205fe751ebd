//! Dempster–Shafer evidence for occupancy mapping: cells, tiles, grids, submaps, fusion and read-outs. No I/O.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod block_tile;
mod cell;
mod cell_coder;
mod cell_state;
mod cell_table;
mod directory;
mod grid;
mod masses;
pub mod range_coder;
mod submap;
mod submap_bytes;
mod submap_outline;
mod submap_version_2;
mod tile;
mod weight_levels;

pub use block_tile::BlockTile;
pub use cell::{Cell, PACKED_WEIGHT_MAX_NAT, PackedCell, WEIGHT_SCALE};
pub use cell_state::CellState;
pub use cell_table::CellTable;
pub use directory::{TileDirectory, TooFar};
pub use grid::{Level, ScoreReader, TileGrid, floor};
pub use masses::{Masses, NotMasses, UnnormalisedMasses};
pub use submap::{Submap, SubmapTile};
pub use submap_bytes::{SubmapBytesError, with_masked};
pub use submap_outline::SubmapOutline;
pub use tile::{CellIndex, TILE_CELLS, TILE_SIDE, Tile, TileKey};
