//! What the system must allow a set: memory that is shared, and open files.

use super::SetError;
use crate::configuration::Configuration;
use flockslam_bus::{Needs, Room};
use flockslam_messages::Stage;
use flockslam_stage::StageOptions;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Files that a process of a set with one process for each stage opens, and some for readers from outside (measured: 245 of the
/// mapper, which has a queue to each reader of each of its lanes).
pub const OPEN_FILES: u64 = 320;
/// More of them for each further process that a stage has (measured: 58).
const FILES_FOR_REPLICAS: u64 = 128;

/// Lets this process, and those that it starts, open as many files as the system allows it to.
pub fn raise_open_files() {
    let limit = getrlimit(Resource::Nofile);
    // What stays too low is reported when a set is started.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, ..limit });
}

/// Whether a set can be started here.
///
/// # Errors
/// What is too small, how much is needed, and the cure.
pub fn check(configuration: &Configuration, options: &StageOptions) -> Result<(), SetError> {
    let most = Stage::ALL.into_iter().map(|stage| configuration.replicas(stage)).max().unwrap_or(1);
    let allowed = getrlimit(Resource::Nofile).current;
    enough_files(OPEN_FILES + FILES_FOR_REPLICAS * (most as u64 - 1), allowed)?;
    let needs = Needs::of(&options.capacity(), |stage| configuration.replicas(stage));
    Ok(needs.check(Room::now())?)
}

/// No limit when `None`.
fn enough_files(needed: u64, allowed: Option<u64>) -> Result<(), SetError> {
    match allowed {
        Some(allowed) if allowed < needed => Err(SetError::OpenFiles { needed, allowed }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_open_files_are_reported_with_the_number_and_the_cure() {
        assert!(enough_files(320, None).is_ok() && enough_files(320, Some(320)).is_ok());
        let text = enough_files(320, Some(64)).unwrap_err().to_string();
        assert!(text.contains("320") && text.contains("allows 64") && text.contains("ulimit -n"), "{text}");
    }
}
