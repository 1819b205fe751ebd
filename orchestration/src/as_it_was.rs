//! A recording of a set, run again as it was: matcher, mapper and cleaner compute each pose from the recorded scans, in the order
//! and with the inputs that they had, and each is compared with the one that was published.

mod black_box;
mod cleaner_rerun;
mod comparison;
mod grid_copy;
mod mapper_rerun;
mod matcher_rerun;
mod rerun;

pub use black_box::{BlackBox, BlackBoxError};
pub use comparison::{Comparison, Difference, Gap};
pub use rerun::run_as_it_was;
