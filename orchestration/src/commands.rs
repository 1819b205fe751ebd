//! What the command line can do, one file a command.

mod accounting;
mod as_it_was_command;
pub mod config;
mod contacts;
pub mod control_command;
pub mod demo;
pub mod doctor_command;
pub mod evaluate;
pub mod inspect;
mod joined_map;
mod lidar_calibration;
pub mod lidar_command;
mod localisation_map;
pub mod log_command;
pub mod manuals_command;
pub mod map;
mod meetings;
mod mode_order;
pub mod page_command;
mod progress_bar;
pub mod record_command;
pub mod ros_command;
mod run;
mod run_services;
pub mod setup_command;
pub mod stage;
pub mod store_command;
pub mod swarm;
pub mod top_command;
pub mod up;

use crate::configuration::ConfigurationError;
use crate::supervisor::SetError;
use flockslam_bus::BusError;
use std::io::Write;

/// Writes to the standard output. A reader that has gone away (`| head`) is no failure of the command.
fn print(text: &str) {
    let _ = std::io::stdout().write_all(text.as_bytes());
}

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// Something that was given is not usable: exit code 2.
    #[error("{0}")]
    User(String),
    /// Something failed while it worked: exit code 1.
    #[error("{0}")]
    Failed(String),
}

impl CommandError {
    /// An error in what the user gave.
    pub fn user(reason: impl std::fmt::Display) -> Self {
        Self::User(reason.to_string())
    }

    /// An error on the way.
    pub fn failed(reason: impl std::fmt::Display) -> Self {
        Self::Failed(reason.to_string())
    }
}

impl From<ConfigurationError> for CommandError {
    fn from(error: ConfigurationError) -> Self {
        Self::user(error)
    }
}

impl From<SetError> for CommandError {
    fn from(error: SetError) -> Self {
        match error {
            SetError::Source(reason) => Self::User(reason),
            SetError::Runtime(error) => Self::user(error),
            error @ (SetError::TooSmall(_)
            | SetError::OpenFiles { .. }
            | SetError::Bus(BusError::NoRoom { .. })) => Self::user(error),
            other => Self::failed(other),
        }
    }
}
