//! A scan and its pose become evidence, tiles and submaps.

mod mapper;
pub mod process;
mod settings;
mod window;

pub use mapper::{Insertion, Mapper};
pub use settings::{ReadOut, SensorModelKind, Settings};
