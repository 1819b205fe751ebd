//! A node of a ROS 2 graph without an installation of ROS: what its command line and environment say, its messages, and its topics
//! and services over DDS, or over zenoh as rmw_zenoh has them. The only crate that knows DDS.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod dds_node;
mod environment;
mod graph_names;
mod interface_definitions;
pub mod messages;
mod node_arguments;
mod parameter_file;
mod parameter_server;
mod parameter_value;
mod quality_of_service;
mod ros_error;
mod ros_node;
mod sender_clock;
mod type_hash;
mod zenoh_names;
mod zenoh_node;

pub use environment::{Environment, Middleware, Reach};
pub use graph_names::{NodeIdentity, Remap};
pub use node_arguments::NodeArguments;
pub use parameter_file::parameters_of_file;
pub use parameter_value::ParameterValue;
pub use quality_of_service::QualityOfService;
pub use ros_error::RosError;
pub use ros_node::{Answer, Call, Node, Parameter, Publisher, RunningNode};
pub use type_hash::{interface_names, type_hash};
