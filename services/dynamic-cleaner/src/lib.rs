//! A scan, its pose and the grid become clearances of stale cells: what is marked as occupied although beams from
//! several places pass through it far beyond is gone (after P. Trubin et al., Omsk 2020, with margins in place of
//! segments; their own way, by segments in angular sectors, can be chosen).

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod cells;
mod cleaner;
mod moving;
pub mod process;
#[cfg(test)]
mod scenarios;
mod sector;
mod sector_share;
mod settings;
mod tracking;
mod votes;

pub use cleaner::{DynamicCleaner, Marks};
pub use sector::Sector;
pub use settings::{Method, Settings};
