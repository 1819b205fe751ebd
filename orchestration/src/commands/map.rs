//! `flockslam map`: a lidar log becomes a map.

use super::as_it_was_command;
use super::lidar_calibration::setting;
use super::run::{Run, run as run_set, summary};
use super::{CommandError, print};
use crate::arguments::{MapArgs, RunArgs};
use crate::configuration::Configuration;
use flockslam_lidar_ingest::process::{Source, count_scans};
use std::path::Path;

/// Where the first of two readings writes, below the outputs.
const FIRST_PASS: &str = "first-pass";

/// Runs the command.
///
/// # Errors
/// When the log, the configuration or the directory is not usable, or the set fails.
pub fn run(args: &MapArgs) -> Result<(), CommandError> {
    if let (Some(log), true) = (&args.log, args.as_it_was) {
        return as_it_was_command::run(log, &args.run.out);
    }
    // What was named for itself comes after the settings, and counts.
    let mut run = args.run.clone();
    run.configuration.assignments.extend(args.topics.assignments());
    let mut calibrates = false;
    let (source, scans) = match (&args.log, &args.source) {
        (Some(log), _) => {
            let absolute = std::path::absolute(log)
                .map_err(|e| CommandError::user(format!("{}: {e}", log.display())))?;
            let given = &run.configuration;
            let configuration =
                Configuration::load(given.profile, given.config.as_deref(), &given.assignments)?;
            calibrates = configuration.lidar_ingest.calibrate;
            let scans = count_scans(log, &configuration.lidar_ingest).map_err(CommandError::user)?;
            (Source::Log(absolute), Some(scans))
        }
        (None, given) => (scans_source(given.as_deref().unwrap_or(Path::new("")))?, None),
    };
    if let (Source::Log(log), true) = (&source, calibrates) {
        calibrate(&mut run, log, scans)?;
    }
    let outcome = run_set(&run, Run { source, world: None, scans, continues: None })?;
    print(&summary(&run.out, &outcome.report));
    Ok(())
}

/// Reads the recording once to estimate where its lidars sit, and adds what it has found to the settings.
fn calibrate(run: &mut RunArgs, log: &Path, scans: Option<u64>) -> Result<(), CommandError> {
    let out = run.out.join(FIRST_PASS);
    let first = RunArgs { out: out.clone(), metrics_port: None, rate: None, live: false, ..run.clone() };
    let source = Source::Log(log.to_owned());
    let outcome = run_set(&first, Run { source, world: None, scans, continues: None });
    // What it has written is of no use.
    let removed = std::fs::remove_dir_all(&out).map_err(CommandError::failed);
    let rows = outcome?.report.calibration;
    removed?;
    let given = &run.configuration;
    let configuration = Configuration::load(given.profile, given.config.as_deref(), &given.assignments)?;
    rows.iter().for_each(|row| print(&row.line()));
    if rows.is_empty() {
        print("no lidar could be calibrated: that takes odometry and some turns\n");
    }
    let assignment = format!("lidar_ingest.calibration={}", setting(&rows, &configuration));
    print(&format!("--set '{assignment}'\n\n"));
    run.configuration.assignments.push(assignment);
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
