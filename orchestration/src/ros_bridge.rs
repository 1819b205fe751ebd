//! The bridge between a set and a ROS 2 graph: a process beside the stages that is a node of the graph and a reader of the bus.
//!
//! What sensors say in the graph goes to lidar-ingest over its local socket; poses, transforms, the map and the state of the set go
//! into the graph. A crash of it harms no stage.

mod bond;
mod bridge;
mod bridge_error;
mod bridge_parameters;
mod bridge_publishers;
mod bridge_services;
mod diagnostics_thread;
mod graph_clock;
mod graph_map;
mod graph_markers;
mod graph_subscriptions;
mod kept_state;
mod lifecycle;
mod localisation_relay;
mod log_relay;
mod map_beginning;
mod map_change;
mod map_correction;
mod map_picture;
mod map_thread;
mod sensor_messages;
mod sensor_relay;
mod set_diagnostics;
mod track_markers;
mod transform_filter;

pub use bridge::{BridgeSet, check_arguments, run_bridge};
pub use bridge_error::BridgeError;
pub use map_picture::{MapPainter, MapPicture};
