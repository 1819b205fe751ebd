//! Process sets: starting, watching, restarting and stopping the stages of one robot.

mod child;
mod control_socket;
mod hang;
mod lidar_description;
mod metrics;
mod notify;
mod restarts;
mod set;
mod set_description;
mod set_error;
mod set_file;
mod side_process;
mod stage_command;
mod starvation;
mod status;
mod supervision;
mod system_limits;

pub use control_socket::{ControlError, ControlSocket, Order, Reply, Request, ask, known_stage};
pub use lidar_description::{LidarLine, NamedLidar};
pub use metrics::{MetricsService, set_metrics_socket};
pub use notify::ServiceManager;
pub use set::{EXIT_BAD_SOURCE, ProcessSet, SetEvent, error_file};
pub use set_description::{RosDescription, SetDescription, SourceDescription, is_of_graph};
pub use set_error::SetError;
pub use set_file::SetFile;
pub use side_process::SideProcess;
pub use stage_command::{run_in, run_stage, shell_in};
pub use status::{ModeStatus, SaveStatus, SetState, SetStatus, StageState, StageStatus};
pub use supervision::{ProcessLimits, Supervision};
pub use system_limits::{OPEN_FILES, raise_open_files};
