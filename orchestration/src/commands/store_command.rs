//! `flockslam store`: saved maps are checked, saved, loaded and exported.

use super::control_command::{choose, order};
use super::joined_map::{Order, join};
use super::run::{Run, run as run_set, summary};
use super::{CommandError, print};
use crate::arguments::{ExportArgs, ImportArgs, MapDirArgs, MapOrderArgs, MergeArgs, RunArgs, StoreCommand};
use crate::configuration::Configuration;
use crate::store::{SavedMap, StoreError, import_map, read_nav2_map};
use crate::supervisor::Request;
use flockslam_lidar_ingest::process::Source;
use std::path::{Path, PathBuf};

/// Runs one of the commands.
///
/// # Errors
/// When the map or the set is not usable, or what is asked for fails.
pub fn run(command: &StoreCommand) -> Result<(), CommandError> {
    match command {
        StoreCommand::Check(args) => check(args),
        StoreCommand::Save(args) => give(args, Request::Save),
        StoreCommand::Load(args) => give(args, Request::Load),
        StoreCommand::Export(args) => export(args),
        StoreCommand::Import(args) => import(args),
        StoreCommand::Merge(args) => merge(args),
    }
}

fn check(args: &MapDirArgs) -> Result<(), CommandError> {
    let findings = SavedMap::at(&args.directory).check().map_err(|error| match error {
        StoreError::Absent(_) => CommandError::user(error),
        error => CommandError::failed(error),
    })?;
    print(&format!(
        "{}: {} poses, {} scans in the map, {} closed submaps\n",
        args.directory.display(),
        findings.poses,
        findings.accepted,
        findings.submaps
    ));
    match findings.problems.as_slice() {
        [] => Ok(()),
        problems => Err(CommandError::failed(format!("damaged: {}", problems.join("; ")))),
    }
}

fn give(args: &MapOrderArgs, request: impl Fn(PathBuf) -> Request) -> Result<(), CommandError> {
    let directory = std::path::absolute(&args.directory).map_err(CommandError::user)?;
    order(&choose(&args.robot)?, &request(directory)).map(drop)
}

/// A run without a source: every stage takes in what the map knows, and the results are those of its end.
fn export(args: &ExportArgs) -> Result<(), CommandError> {
    let map = existing(&args.directory)?;
    let run_args = RunArgs {
        out: args.out.clone(),
        rate: None,
        live: false,
        localize: None,
        robot: None,
        metrics_port: None,
        configuration: args.configuration.clone(),
    };
    let run = Run { source: Source::Nothing, world: None, scans: None, continues: Some(map) };
    let outcome = run_set(&run_args, run)?;
    print(&summary(&args.out, &outcome.report));
    Ok(())
}

fn import(args: &ImportArgs) -> Result<(), CommandError> {
    let given = &args.configuration;
    let configuration = Configuration::load(given.profile, given.config.as_deref(), &given.assignments)?;
    let plan = read_nav2_map(&args.map).map_err(CommandError::user)?;
    let imported =
        import_map(&plan, &args.out, configuration.mapper.cell_size_m).map_err(CommandError::user)?;
    print(&format!(
        "{}: {:.0} m² in {} submaps, seen from {} places; wrote a saved map to {}\n",
        args.map.display(),
        imported.area_m2,
        imported.submaps,
        imported.views,
        args.out.display()
    ));
    Ok(())
}

/// Each map becomes a robot, by a run without a source; then these meet.
fn merge(args: &MergeArgs) -> Result<(), CommandError> {
    let mut members = Vec::new();
    for (number, directory) in (1..).zip(&args.directories) {
        existing(directory)?;
        let name = format!("map-{number:03}");
        let command = ["store".as_ref(), "export".as_ref(), directory.as_os_str()];
        let order = Order { name: &name, command: &command, assignments: &[], out: &args.out.join(&name) };
        members.push(order.run(&args.configuration)?);
    }
    let joined = join(&args.out, members)?;
    print(&joined.summary(&args.out));
    Ok(())
}

fn existing(directory: &Path) -> Result<SavedMap, CommandError> {
    let map = SavedMap::at(directory);
    if map.exists() { Ok(map) } else { Err(CommandError::user(StoreError::Absent(directory.to_owned()))) }
}
