//! Judges cells of a map by a scan: passed through or supported, each in constant time.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod horizon;
mod pass_through;
mod polar_range_image;

pub use horizon::{COARSE_DIRECTIONS, Horizon, coarse_direction, coarse_directions};
pub use pass_through::{Margins, PassThrough, Visibility};
pub use polar_range_image::{Directions, PolarRangeImage};
