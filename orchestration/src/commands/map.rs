//! `flockslam map`: a lidar log becomes a map.

use super::run::{Run, run as run_set, summary};
use super::{CommandError, say};
use crate::arguments::MapArgs;
use crate::configuration::Configuration;
use flockslam_lidar_ingest::process::{Source, count_scans};
use std::path::Path;

/// Runs the command.
///
/// # Errors
/// When the log, the configuration or the directory is not usable, or the set fails.
pub fn run(args: &MapArgs) -> Result<(), CommandError> {
    // What was named for itself comes after the settings, and counts.
    let mut run = args.run.clone();
    run.configuration.assignments.extend(args.topics.assignments());
    let (source, scans) = match (&args.log, &args.source) {
        (Some(log), _) => {
            let absolute = std::path::absolute(log)
                .map_err(|e| CommandError::user(format!("{}: {e}", log.display())))?;
            let given = &run.configuration;
            let configuration =
                Configuration::load(given.profile, given.config.as_deref(), &given.assignments)?;
            let scans = count_scans(log, &configuration.lidar_ingest).map_err(CommandError::user)?;
            (Source::Log(absolute), Some(scans))
        }
        (None, given) => (scans_source(given.as_deref().unwrap_or(Path::new("")))?, None),
    };
    let outcome = run_set(&run, Run { source, world: None, scans, continues: None })?;
    say(&summary(&run.out, &outcome.report));
    Ok(())
}

/// The source of scans that is no recording.
fn scans_source(given: &Path) -> Result<Source, CommandError> {
    match given.as_os_str().as_encoded_bytes() {
        b"-" => Ok(Source::Pipe),
        b"scans" => Ok(Source::Scans(None)),
        [b's', b'c', b'a', b'n', b's', b':', ..] => {
            let path = given.to_string_lossy();
            let path = Path::new(path.trim_start_matches("scans:"));
            std::path::absolute(path)
                .map(|path| Source::Scans(Some(path)))
                .map_err(|error| CommandError::user(format!("--source {}: {error}", given.display())))
        }
        _ => Err(CommandError::user(format!(
            "--source {}: known are '-', the standard input, and 'scans' or 'scans:PATH', a local socket",
            given.display()
        ))),
    }
}
