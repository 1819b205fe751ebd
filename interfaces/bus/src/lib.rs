//! The only code that opens iceoryx2: topics with their limits, ports, events to wait on, and what a set of processes
//! leaves in shared memory. An in-memory twin carries the same messages between threads of one process.
//!
//! A process set has one [`Bus::host`]: the supervisor, which creates and holds every service, since a kill during the
//! creation of a service can wedge its name for good. Stages [`Bus::join`] and only open.

mod bus;
mod bus_error;
mod event;
mod half_made_guard;
mod memory_bus;
mod needs;
mod orphans;
mod port;
mod room;
mod runtime;
mod scan_port;
mod service;
mod shared_event;
mod shared_memory_bus;
mod shared_sample;
mod tile_port;
mod topic;
mod transport;
mod word_rows;

pub use bus::{Bus, SUPERVISOR_EVENT};
pub use bus_error::BusError;
pub use event::{Listener, Notifier, Wake};
pub use half_made_guard::half_made_publishers;
pub use needs::{Needs, TooSmall};
pub use orphans::OrphanedNodes;
pub use port::{Publisher, Sample, SlicePublisher, SliceSample, SliceSubscriber, Subscriber};
pub use room::{Megabytes, Room};
pub use runtime::{RuntimeDir, RuntimeError};
pub use scan_port::{ScanPublisher, ScanSample, ScanSubscriber};
pub use tile_port::{TileHandle, TilePublisher};
pub use topic::{Capacity, LargeScanHeader, Limits, SliceTopic, Topic};
