//! The only writer of durable state: checksummed records, atomic replacement.
