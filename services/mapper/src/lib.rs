//! A scan and its pose become evidence, tiles and submaps.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod closed_submap;
mod mapper;
pub mod process;
mod score;
mod settings;
mod tile_share;
mod unconfirmed_objects;
mod window;
mod window_tile;

pub use mapper::{Insertion, Mapper};
pub use settings::{ReadOut, SensorModelKind, Settings};
pub use tile_share::TileShare;
