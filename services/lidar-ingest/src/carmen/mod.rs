//! CARMEN text logs: one message a line, separated by blanks.
//!
//! FLASER and ROBOTLASER1 lines become scans; ODOM, PARAM and comments are known and need nothing, since each scan line
//! carries the robot's and the laser's pose itself. The order of the lines is the order of the scans, whatever the stamps
//! say.

mod carmen_line;
mod carmen_reader;
mod line_tally;
mod rejection;
mod shifted_odometry;
mod write;

pub use carmen_reader::{CarmenReader, ReadError};
pub use line_tally::Tally;
pub use rejection::Rejection;
pub use shifted_odometry::ShiftedOdometry;
pub use write::write_scan;
