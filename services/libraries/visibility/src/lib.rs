//! What a scan says of the cells of a map: which of them it looks through, and which it finds standing, each in constant time.

mod sight;
mod view;

pub use sight::{Directions, Sight};
pub use view::{Finding, Margins, View};
