//! Dempster–Shafer evidence for occupancy mapping: cells, tiles, grids, submaps, fusion and read-outs. No I/O.

mod cell;
mod directory;
mod fused_map;
mod grid;
mod masses;
mod ray;
mod sensor_model;
mod submap;
mod submap_bytes;
mod tile;

pub use cell::{Cell, PACKED_WEIGHT_MAX_NAT, PackedCell, WEIGHT_SCALE};
pub use directory::{TileDirectory, TooFar};
pub use fused_map::{FusedMap, NotFused};
pub use grid::{Level, ScoreReader, TileGrid, floor};
pub use masses::{Masses, NotMasses, UnnormalisedMasses};
pub use ray::Ray;
pub use sensor_model::{ObservedCells, SensorModel};
pub use submap::{Submap, SubmapTile};
pub use submap_bytes::SubmapBytesError;
pub use tile::{CellIndex, TILE_CELLS, TILE_SIDE, Tile, TileKey};
