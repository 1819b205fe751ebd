//! What the shells of all stages share. A stage's logic is a pure function in its own crate; its `process.rs` feeds
//! that function from the bus with what is here: the loop, joins by scan identity, the grid reader, the journal of
//! scans and poses, acknowledgements, and the report about itself.

mod actor;
mod context;
mod deadline;
mod final_message;
mod grid_reader;
mod inbox;
mod input_log;
mod join;
mod leader_lock;
mod notifiers;
mod pause;
mod process_memory;
mod progress;
mod report;
mod scan_journal;
mod shares;
mod stage_clock;
mod stage_error;

pub use actor::{Actor, run, step_aside};
pub use context::{Mode, StageContext, StageOptions, StopFlag, heartbeat_file, metrics_socket};
pub use deadline::Deadline;
pub use final_message::FinalMessage;
pub use flockslam_journal::{GrowingFile, Refusal};
pub use grid_reader::GridReader;
pub use inbox::{Copies, Inbox, Named, Port};
pub use input_log::InputLog;
pub use join::{Join, Waited};
pub use leader_lock::{LeaderLock, leader};
pub use notifiers::Notifiers;
pub use pause::Pause;
pub use process_memory::MemoryUse;
pub use progress::{Acknowledger, StreamEnd};
pub use report::{ProcessReport, read_reports};
pub use scan_journal::{JournalReader, JournalWriter, Journaled, journal_file, pose_of};
pub use shares::{Share, Shares};
pub use stage_clock::Clock;
pub use stage_error::StageError;
