//! What a running set says on its bus, in the forms that Foxglove and its relatives read: a file (MCAP) and a websocket.
//!
//! A recorder is one more reader of the bus. It delays nothing else: what it is too slow for is replaced by newer messages, and the
//! gap is counted.

mod foxglove_messages;
mod live_grid;
mod mcap_file;
mod scene;
mod set_reader;
mod topics;
mod websocket;

pub use foxglove_messages::{Recorded, bus_scan, log, pose, scan, set_record, transforms};
pub use live_grid::LiveGrid;
pub use mcap_file::McapFile;
pub use scene::tracks;
pub use set_reader::{SetReader, request_tiles};
pub use topics::RecordTopic;
pub use websocket::FoxgloveServer;

/// Why something could not be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file cannot be written.
    #[error("{path}: {problem}")]
    File {
        /// Which file.
        path: std::path::PathBuf,
        /// What was wrong.
        problem: String,
    },
    /// The port cannot be opened.
    #[error("127.0.0.1:{port}: {source}")]
    Port {
        /// Which port.
        port: u16,
        /// Message of the system.
        source: std::io::Error,
    },
    /// The set cannot be listened to.
    #[error(transparent)]
    Bus(#[from] flockslam_bus::BusError),
}
