//! Reasons for which lines of a log and scans are rejected.

/// Why a line of a log was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
pub enum Rejection {
    /// The line has bytes that are no text.
    #[error("not text: is this a binary file?")]
    NotText,
    /// The line is longer than is stored.
    #[error("the line is longer than 64 MiB")]
    TooLong,
    /// The line ends before its message does.
    #[error("the line has too few fields")]
    TooFewFields,
    /// The number of ranges is not the announced one.
    #[error("the line has more fields than its number of beams allows")]
    TooManyFields,
    /// The announced number of beams is none, not a number, or too large.
    #[error("the number of beams is not between 1 and 10 million")]
    BeamCount,
    /// A field that should be a number is none.
    #[error("a field is not a number")]
    BadNumber,
    /// A pose or an angle is NaN, infinite or absurdly large.
    #[error("a pose or an angle is not a finite number of sensible size")]
    BadPose,
    /// The stamp is not a decimal number of seconds.
    #[error("the time stamp is not a number")]
    BadStamp,
    /// The scan is stamped seconds before scans that came earlier.
    #[error("the scan is older than those before it")]
    TimeReversed,
    /// Odometry has moved and every range is the same as before.
    #[error("the scan repeats the one before it although the robot has moved")]
    Frozen,
    /// A message of a recording does not match its type.
    #[error("a message does not match its type")]
    BadMessage,
    /// Bytes of a stream are no frame.
    #[error("bytes that are no frame")]
    BadFrame,
    /// It is not known where the lidar sits.
    #[error("it is not known where the lidar sits")]
    Unplaced,
    /// A lidar that is not read.
    #[error("the lidar is not one of those that are read")]
    UnknownLidar,
}

impl Rejection {
    /// A short name for counters and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::NotText => "not_text",
            Self::TooLong => "too_long",
            Self::TooFewFields => "too_few_fields",
            Self::TooManyFields => "too_many_fields",
            Self::BeamCount => "beam_count",
            Self::BadNumber => "bad_number",
            Self::BadPose => "bad_pose",
            Self::BadStamp => "bad_stamp",
            Self::TimeReversed => "time_reversed",
            Self::Frozen => "frozen",
            Self::BadMessage => "bad_message",
            Self::BadFrame => "bad_frame",
            Self::Unplaced => "unplaced",
            Self::UnknownLidar => "unknown_lidar",
        }
    }
}
