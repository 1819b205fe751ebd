//! Records that robots exchange.
//!
//! Each robot owns an append-only log of [`Record`]s: submaps, stretches of its pose graph, constraints, clearances,
//! withdrawals. A record is named (robot, epoch, number) and by the BLAKE3 hash of its bytes, and signed by its robot. A
//! [`Collection`] is what one robot knows of all logs: it only grows, so collections that have received the same records are the same,
//! whatever the order, repetition or detours. [`Vector`]s say what a collection has; [`Collection::missing`] answers one.
//!
//! The bytes may be anything: every length is checked against a limit before memory is asked for.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod codec;
mod collection;
mod content;
mod flock_message;
mod kind;
mod numbers;
mod presence;
mod record;
mod record_error;
mod robot;
mod sealed;
mod vector;

pub use collection::{Collection, Limits, Outcome, Refusal, Tally};
pub use content::{
    CONSTRAINTS_MAX, Clearance, Constraint, Content, Descriptor, NodeName, RecordedNode, Stretch,
    SubmapRecord, Withdrawal, rounded_point,
};
pub use flock_message::{MESSAGE_BYTES_MAX, Message};
pub use kind::Kind;
pub use numbers::Numbers;
pub use presence::Presence;
pub use record::{Record, RecordName};
pub use record_error::RecordError;
pub use robot::{RobotId, RobotKey};
pub use sealed::{PAYLOAD_BYTES_MAX, RECORD_BYTES_MAX, SCHEMA_VERSION};
pub use vector::{LogState, Vector};
