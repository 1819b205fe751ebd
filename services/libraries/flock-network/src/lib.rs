//! A robot's side of the flock: a thread that publishes the robot's records, takes in those of others, looks for places that both have
//! seen, and works out the common solution.

mod common;
mod drops;
mod flock_exchange;
mod identity;
mod link;
mod metrics;
mod pace;
mod proximity;
mod record_publisher;
mod relay;
mod robot_poses;
mod settings;
mod thread;
mod thread_state;

pub use metrics::FlockMetrics;
pub use record_publisher::RecordPublisher;
pub use settings::{FlockSettings, ProximitySource};
pub use thread::FlockThread;
pub use thread_state::Task;
