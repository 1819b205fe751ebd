//! Why a node cannot be part of a graph.

use std::path::PathBuf;

/// Why a node cannot be part of a graph.
#[derive(Debug, thiserror::Error)]
pub enum RosError {
    /// A variable of the environment has no sense.
    #[error("{name}={value}: {reason}")]
    Environment {
        /// The variable.
        name: &'static str,
        /// Its message.
        value: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// The configuration of zenoh cannot be used.
    #[error("{name}={value}: {reason}")]
    Zenoh {
        /// The variable that has it.
        name: &'static str,
        /// Its message.
        value: String,
        /// Message of zenoh.
        reason: String,
    },
    /// An argument behind `--ros-args` has no sense.
    #[error("--ros-args {argument}: {reason}")]
    Argument {
        /// The argument.
        argument: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A file of parameters cannot be used.
    #[error("{path}: {reason}")]
    ParameterFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A name is none by the rules of ROS.
    #[error("'{name}' is not a name that ROS allows: {reason}")]
    Name {
        /// The name.
        name: String,
        /// The rule.
        reason: String,
    },
    /// The network refuses.
    #[error("cannot join the ROS graph of domain {domain}: {reason}")]
    Network {
        /// The domain.
        domain: u16,
        /// Message of the system.
        reason: String,
    },
    /// A topic or a service cannot be opened.
    #[error("cannot open {name}: {reason}")]
    Open {
        /// The topic or service.
        name: String,
        /// Message of the network.
        reason: String,
    },
}
