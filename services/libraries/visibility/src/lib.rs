//! What a scan says of the cells of a map: which of them it looks through, and which it finds standing, each in constant time.

mod pass_through;
mod polar_range_image;

pub use pass_through::{Margins, PassThrough, Visibility};
pub use polar_range_image::{Directions, PolarRangeImage};
