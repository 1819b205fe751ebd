//! Process sets: starting, watching, restarting and stopping the stages of one robot.

mod child;
mod set;
mod set_file;
mod stage_command;

pub use set::{EXIT_BAD_SOURCE, ProcessSet, SetError, SetEvent, error_file};
pub use set_file::SetFile;
pub use stage_command::{run_in, run_stage};
