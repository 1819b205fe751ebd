//! Drives in one process: matcher, cleaner and mapper are called in turn, without a bus. System tests and benchmarks measure them.
//!
//! A library of its own, since the logic of stages is generic over the grid: here it is compiled once, and optimised.

pub mod experiments;
pub mod followed;
pub mod matching;
pub mod ndt_system;
pub mod nees;
