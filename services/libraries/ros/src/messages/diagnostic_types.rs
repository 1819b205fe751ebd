//! How a program is.

use super::{Header, message};
use serde::{Deserialize, Serialize};

/// `diagnostic_msgs/KeyValue`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What.
    pub key: String,
    /// How much of it.
    pub value: String,
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// One of the constants.
    pub level: u8,
    /// Of what.
    pub name: String,
    /// For people.
    pub message: String,
    /// Which robot.
    pub hardware_id: String,
    /// Figures.
    pub values: Vec<KeyValue>,
}

impl DiagnosticStatus {
    /// All is well.
    pub const OK: u8 = 0;
    /// A warning.
    pub const WARN: u8 = 1;
    /// It does not work.
    pub const ERROR: u8 = 2;
    /// Nothing came of it for too long.
    pub const STALE: u8 = 3;
}

message! {
    /// `diagnostic_msgs/DiagnosticArray`.
    DiagnosticArray = "diagnostic_msgs" {
        /// When.
        header: Header,
        /// One for each part.
        status: Vec<DiagnosticStatus>,
    }
}
