//! Transforms between frames.

use super::{Header, Quaternion, Vector3, message};
use serde::{Deserialize, Serialize};

/// `geometry_msgs/Transform`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Where.
    pub translation: Vector3,
    /// Turned how.
    pub rotation: Quaternion,
}

/// `geometry_msgs/TransformStamped`: the pose of a frame in its parent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// When, and the parent.
    pub header: Header,
    /// The frame.
    pub child_frame_id: String,
    /// Its pose.
    pub transform: Transform,
}

message! {
    /// `tf2_msgs/TFMessage`.
    TFMessage = "tf2_msgs" {
        /// Any number.
        transforms: Vec<TransformStamped>,
    }
}
