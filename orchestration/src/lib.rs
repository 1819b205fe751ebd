//! Process sets: the command line, the supervisor, outputs, and evaluation against ground truth.

pub mod cli;
pub mod commands;
pub mod configuration;
pub mod epoch;
pub mod evaluation;
pub mod outputs;
pub mod store;
pub mod supervisor;

/// Version of this build.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
