//! Why bytes of a stream are no frame.

/// What is wrong with bytes that came. The reader goes on behind them.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameProblem {
    /// Bytes that begin neither a frame nor a line of JSON.
    #[error("{bytes} bytes that begin neither a binary frame nor a line of JSON")]
    NoFrame {
        /// How many were passed over.
        bytes: usize,
    },
    /// A frame that is longer than any is.
    #[error("a frame of more than 64 MiB")]
    TooLong,
    /// The bytes of a frame are not those that were sent.
    #[error("a frame with a wrong checksum")]
    WrongChecksum,
    /// A kind of frames that this version does not know.
    #[error("a frame of the unknown kind {0}")]
    UnknownKind(u16),
    /// The fields need more or fewer bytes than the frame has.
    #[error("a frame whose length does not match its fields")]
    WrongLength,
    /// Neither none nor more than ten million.
    #[error("a scan whose number of beams is not between 1 and 10 million")]
    BeamCount,
    /// A number that is none.
    #[error("a pose, an angle, a rate or a limit that is not a finite number")]
    NotFinite,
    /// A name that is no text.
    #[error("a name that is not UTF-8, has control characters, or is longer than 255 bytes")]
    BadName,
    /// A line that is not such an object.
    #[error("a line of JSON: {0}")]
    Json(String),
    /// Lists of one scan have different lengths.
    #[error("a scan whose lists have different lengths")]
    UnequalLists,
}
