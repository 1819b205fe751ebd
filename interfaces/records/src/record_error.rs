//! The reasons for which bytes are refused.

/// Why bytes are not a record or a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// The bytes end too early.
    #[error("the bytes end in the middle")]
    Truncated,
    /// The bytes are something else.
    #[error("not a record of the flock")]
    NotARecord,
    /// Written by a build that this one does not know.
    #[error("schema version {0}, this build reads version {known}", known = crate::SCHEMA_VERSION)]
    Version(u8),
    /// A kind that this build does not know.
    #[error("a record of unknown kind {0}")]
    Kind(u8),
    /// More than a record may hold.
    #[error("{what}: {claimed} of at most {limit}")]
    TooMuch {
        /// Of what.
        what: &'static str,
        /// The claimed value.
        claimed: u64,
        /// The limit.
        limit: u64,
    },
    /// A value that is out of its range.
    #[error("not well formed: {0}")]
    Malformed(&'static str),
    /// Bytes follow after the end.
    #[error("{0} bytes follow the end")]
    Trailing(usize),
    /// The signature is not that of the robot that is named.
    #[error("the signature is not that of robot {0}")]
    Signature(String),
}
