//! Process sets: starting, watching, restarting and stopping the stages of one robot.

mod child;
mod control;
mod description;
mod error;
mod hang;
mod notify;
mod restarts;
mod set;
mod set_file;
mod stage_command;
mod status;
mod supervision;

pub use control::{ControlError, ControlSocket, Order, Reply, Request, ask, known_stage};
pub use description::{SetDescription, SourceDescription};
pub use error::SetError;
pub use notify::ServiceManager;
pub use set::{EXIT_BAD_SOURCE, ProcessSet, SetEvent, error_file};
pub use set_file::SetFile;
pub use stage_command::{run_in, run_stage};
pub use status::{SaveStatus, SetState, SetStatus, StageState, StageStatus};
pub use supervision::{ProcessLimits, Supervision};
