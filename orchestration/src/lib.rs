//! Process sets: the command line, the supervisor, outputs, and evaluation against ground truth.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

pub mod arguments;
pub mod as_it_was;
pub mod cli;
pub mod commands;
pub mod configuration;
pub mod doctor;
mod doctor_arguments;
pub mod evaluation;
pub mod lidar_arguments;
pub mod lidar_view;
mod localisation_arguments;
mod manuals_arguments;
pub mod outputs;
pub mod recording;
pub mod ros_bridge;
pub mod setup;
mod setup_arguments;
mod stage_arguments;
pub mod state_directory;
pub mod store;
pub mod supervisor;
mod time_slice;
pub mod top;
pub mod topic_arguments;

/// Version of this build.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
