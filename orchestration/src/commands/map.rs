//! `flockslam map`: a lidar log becomes a map.

use super::run::{Run, run as run_set, summary};
use super::{CommandError, say};
use crate::arguments::MapArgs;
use crate::configuration::Configuration;
use flockslam_lidar_ingest::process::{Source, count_scans};

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
        (None, Some(dash)) if dash.as_os_str() == "-" => (Source::Pipe, None),
        (None, other) => {
            let given = other.as_deref().unwrap_or(std::path::Path::new("")).display().to_string();
            return Err(CommandError::user(format!(
                "--source {given}: the one source known is '-', the standard input"
            )));
        }
    };
    let outcome = run_set(&run, Run { source, world: None, scans, continues: None })?;
    say(&summary(&run.out, &outcome.report));
    Ok(())
}
