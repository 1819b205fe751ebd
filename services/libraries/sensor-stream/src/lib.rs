//! What sensors of a robot say – scans, odometry, transforms, rates of turning – and how it travels from a driver to a process set: as
//! binary frames or lines of JSON on a local socket or a pipe.
//!
//! A producer makes [`SensorFrame`]s and hands them to a [`Producer`]; the receiver gives the bytes that come to a
//! [`FrameReader`]. docs/drivers.md describes the frames byte by byte.
//!
//! ```
//! use flockslam_messages::ScanBuffer;
//! use flockslam_sensor_stream::{FrameReader, FramedScan, LidarScan, SensorFrame};
//!
//! let scan = ScanBuffer::from_ranges(&[1.0, 2.0, f32::INFINITY], -0.5, 0.5);
//! let scan = FramedScan { frame: "laser".to_owned(), scan, mounting: None };
//! let frame = SensorFrame::Scan(LidarScan { lidar: "front".to_owned(), scan });
//!
//! let mut bytes = Vec::new();
//! frame.write_binary(&mut bytes);
//! let mut reader = FrameReader::default();
//! reader.push(&bytes);
//! assert_eq!(reader.next_frame(), Some(Ok(frame)));
//! assert_eq!(reader.next_frame(), None);
//! ```

mod binary_frame;
mod frame_problem;
mod frame_reader;
mod json_line;
mod producer;
mod readings;
#[cfg(test)]
mod test_frames;

pub use frame_problem::FrameProblem;
pub use frame_reader::FrameReader;
pub use producer::{Producer, SendError};
pub use readings::{
    BEAMS_MAX, FramedScan, ImuReading, LidarScan, OdometryReading, SensorFrame, TransformsReading,
    is_plausible_sweep,
};
