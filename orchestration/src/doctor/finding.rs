//! A finding: what is wrong, how much it matters, and what to do.

use serde::Serialize;
use std::fmt;

/// Exit code when something was found that is worth a look.
const EXIT_WARNINGS: u8 = 3;
/// Exit code when something was found with which a set does not work.
const EXIT_ERRORS: u8 = 4;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Good to know; the exit code stays 0.
    Info,
    /// A set works, but not as well as it could, or not for long.
    Warning,
    /// A set does not work.
    Error,
}

impl Severity {
    fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// What was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How much it matters.
    pub severity: Severity,
    /// What was looked at, in one or two words.
    pub subject: &'static str,
    /// What is wrong.
    pub what: String,
    /// What to do.
    pub cure: String,
}

impl Finding {
    /// With which a set does not work.
    pub fn error(subject: &'static str, what: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { severity: Severity::Error, subject, what: what.into(), cure: cure.into() }
    }

    /// Worth a look.
    pub fn warning(subject: &'static str, what: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { severity: Severity::Warning, subject, what: what.into(), cure: cure.into() }
    }

    /// Good to know.
    pub fn info(subject: &'static str, what: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { severity: Severity::Info, subject, what: what.into(), cure: cure.into() }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { severity, subject, what, cure } = self;
        // A message of another program may have several lines.
        let line = format!("{:<7} {subject}: {what}; cure: {cure}", severity.name());
        f.write_str(&line.split_whitespace().collect::<Vec<_>>().join(" "))
    }
}

/// The exit code for scripts: 0 without warnings and errors, 3 with warnings, 4 with errors. 1 and 2 stay for what fails on the way and
/// for mistakes in what was given.
pub fn exit_code(findings: &[Finding]) -> u8 {
    match findings.iter().map(|finding| finding.severity).max() {
        None | Some(Severity::Info) => 0,
        Some(Severity::Warning) => EXIT_WARNINGS,
        Some(Severity::Error) => EXIT_ERRORS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finding_is_one_line_and_the_worst_gives_the_exit_code() {
        let info = Finding::info("clock", "it is\nlate", "wait");
        let (warning, error) = (Finding::warning("a", "b", "c"), Finding::error("a", "b", "c"));
        assert_eq!(info.to_string(), "info clock: it is late; cure: wait");
        assert_eq!(exit_code(&[]), 0);
        assert_eq!(exit_code(std::slice::from_ref(&info)), 0);
        assert_eq!(exit_code(&[warning.clone(), info.clone()]), 3);
        assert_eq!(exit_code(&[warning, error, info]), 4);
    }
}
