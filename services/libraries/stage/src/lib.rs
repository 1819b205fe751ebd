//! What the shells of all stages share. A stage's logic is a pure function in its own crate; its `process.rs` feeds
//! that function from the bus with what is here: the loop, joins by scan identity, the grid reader, the journal of
//! scans and poses, acknowledgements, and the report about itself.

mod actor;
mod context;
mod error;
mod grid_reader;
mod memory;
mod pause;
mod pending;
mod pose_queue;
mod progress;
mod report;
mod scan_journal;
mod turn;

pub use actor::{Actor, run, step_aside};
pub use context::{Mode, StageContext, StageOptions, StopFlag, heartbeat_file, metrics_socket};
pub use error::StageError;
pub use grid_reader::GridReader;
pub use memory::MemoryUse;
pub use pause::Pause;
pub use pending::PendingScans;
pub use pose_queue::PoseQueue;
pub use progress::{Acknowledger, StreamEnd};
pub use report::{ProcessReport, read_reports};
pub use scan_journal::{JournalReader, JournalWriter, Journaled, journal_file};
pub use turn::{Turn, whose_turn};
