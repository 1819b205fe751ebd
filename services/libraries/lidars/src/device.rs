//! Identification and health that a lidar reports.

use std::fmt;

/// A lidar, as far as it identifies itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Device {
    /// Its model.
    pub model: Option<String>,
    /// The version of its firmware.
    pub firmware: Option<String>,
    /// Its serial number.
    pub serial_number: Option<String>,
    /// How it is.
    pub health: Option<Health>,
}

/// Health that a lidar reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// All is well.
    Good,
    /// It measures, and reports a warning: its own code.
    Warning(u32),
    /// It does not measure: its own code.
    Failed(u32),
}

impl fmt::Display for Health {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Good => write!(f, "good"),
            Self::Warning(code) => write!(f, "warning {code:#x}"),
            Self::Failed(code) => write!(f, "failed {code:#x}"),
        }
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.model.as_deref().unwrap_or("unknown model"))?;
        for (name, value) in [("firmware", &self.firmware), ("serial number", &self.serial_number)] {
            if let Some(value) = value {
                write!(f, ", {name} {value}")?;
            }
        }
        match self.health {
            Some(health) => write!(f, ", health {health}"),
            None => Ok(()),
        }
    }
}
