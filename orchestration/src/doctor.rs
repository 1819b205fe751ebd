//! What is wrong with a machine and with a set on it, and the cure. Checks are pure; readers fill what they look at.

mod bundle;
mod bundled_picture;
mod finding;
mod machine_checks;
mod machine_reader;
mod machine_readings;
mod redaction;
mod set_checks;
mod set_inspection;
mod set_under_examination;

pub use bundle::{Bundle, BundleError};
pub use finding::{Finding, Severity, exit_code};
pub use machine_checks::check_machine;
pub use machine_reader::{read_disk, read_machine};
pub use machine_readings::{DiskReading, Machine, MemoryReading, PortReading};
pub use redaction::Redaction;
pub use set_checks::check_set;
pub use set_inspection::{inspect_description, inspect_running};
pub use set_under_examination::{LidarRate, LogProblem, RunningReading, SetReading};
