//! Why the bridge to a ROS 2 graph cannot work.

/// Why the bridge to a ROS 2 graph cannot work.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The graph cannot be joined, or an argument has no sense.
    #[error(transparent)]
    Ros(#[from] flockslam_ros::RosError),
    /// A parameter has another type, or no sense.
    #[error("the parameter {name}: {reason}")]
    Parameter {
        /// The parameter.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The set cannot be read.
    #[error(transparent)]
    Bus(#[from] flockslam_bus::BusError),
    /// The system refuses.
    #[error(transparent)]
    System(#[from] std::io::Error),
}
