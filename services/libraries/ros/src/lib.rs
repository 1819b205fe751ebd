//! A node of a ROS 2 graph without an installation of ROS: what its command line and environment say, its messages, and its topics
//! and services over DDS. The only crate that knows DDS.

mod environment;
mod graph_names;
pub mod messages;
mod node_arguments;
mod parameter_file;
mod parameter_value;
mod quality_of_service;
mod ros_error;
mod ros_node;

pub use environment::{Callers, Environment, Reach};
pub use graph_names::{NodeIdentity, Remap};
pub use node_arguments::NodeArguments;
pub use parameter_file::parameters_of_file;
pub use parameter_value::ParameterValue;
pub use quality_of_service::QualityOfService;
pub use ros_error::RosError;
pub use ros_node::{Answer, Call, Node, Parameter, Publisher, RunningNode};
