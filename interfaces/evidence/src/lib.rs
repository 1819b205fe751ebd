//! Dempster–Shafer evidence for occupancy mapping: cells, tiles, grids, submaps, fusion and read-outs. No I/O.

mod cell;
mod cell_coder;
mod cell_table;
mod crossed;
mod directory;
mod footprint;
mod fused_map;
mod grid;
mod levels;
mod masses;
pub mod range_coder;
mod ray;
mod resampling;
mod sensor_model;
mod submap;
mod submap_bytes;
mod tile;

pub use cell::{Cell, PACKED_WEIGHT_MAX_NAT, PackedCell, WEIGHT_SCALE};
pub use cell_table::CellTable;
pub use crossed::CrossedCells;
pub use directory::{TileDirectory, TooFar};
pub use footprint::Footprint;
pub use fused_map::{FusedMap, NotFused};
pub use grid::{Level, ScoreReader, TileGrid, floor};
pub use masses::{Masses, NotMasses, UnnormalisedMasses};
pub use ray::Ray;
pub use sensor_model::{ObservedCells, SensorModel};
pub use submap::{ClearedCells, Submap, SubmapTile};
pub use submap_bytes::SubmapBytesError;
pub use tile::{CellIndex, TILE_CELLS, TILE_SIDE, Tile, TileKey};
