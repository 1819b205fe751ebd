//! Judges cells of a map by a scan: passed through or supported, each in constant time.

mod pass_through;
mod polar_range_image;

pub use pass_through::{Margins, PassThrough, Visibility};
pub use polar_range_image::{Directions, PolarRangeImage};
