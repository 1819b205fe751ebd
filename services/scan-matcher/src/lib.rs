//! A scan and a grid become a pose.

mod contradiction;
mod matcher;
mod motion;
pub mod process;
mod settings;

pub use matcher::ScanMatcher;
pub use settings::{Gate, Rescue, Settings, Strategy};
