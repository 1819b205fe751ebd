//! The evidence of a beam in a grid: the cells along it, and the evidence for each. Pure.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod crossed;
mod ray;
mod sensor_model;

pub use crossed::CrossedCells;
pub use ray::Ray;
pub use sensor_model::{ObservedCells, SensorModel};
