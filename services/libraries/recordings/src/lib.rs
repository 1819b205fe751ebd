//! Recordings of robots, message by message: ROS 1 bags, and rosbag2 folders and their files (SQLite and MCAP).
//!
//! [`Recording`] opens any of them by its content and gives its messages in the order in which they were recorded;
//! [`Reading`] is the content of a message, where it is one of those that are understood.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod any_recording;
mod bag_file;
mod bag_record;
mod cloud_message;
mod db3_file;
mod mcap_messages;
mod message_fields;
mod recording_error;
mod ros_messages;
mod set_record;

pub use any_recording::{Recording, Topic, TopicReading, is_recording};
pub use cloud_message::FramedCloud;
pub use message_fields::{MessageProblem, Wire};
pub use recording_error::RecordingError;
pub use ros_messages::{LaserScanMessage, Reading, ReadingKind};
pub use set_record::{SET_RECORD_TYPE, SetRecord, bus_encoding, set_record_encoding};

/// A message as it was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Message<'a> {
    /// Which of the file's topics.
    topic: usize,
    /// When it was recorded, nanoseconds.
    recorded_ns: i64,
    /// Its serialized fields, where they were read.
    bytes: &'a [u8],
}
