//! The map that a set shall localize in: a saved map, the outputs of a run, or a map of somebody else. It is only read.

use super::CommandError;
use super::run::{Run, run as run_set};
use crate::arguments::{ConfigurationArgs, RunArgs};
use crate::configuration::Profile;
use crate::store::{SavedMap, read_nav2_map};
use crate::supervisor::{SetError, SetFile};
use flockslam_bus::RuntimeDir;
use flockslam_journal::{Durability, replace_file_by};
use flockslam_lidar_ingest::process::Source;
use flockslam_results::{KNOWN_MAP, MapReader, StoredMap, write_map_file};
use std::path::{Path, PathBuf};

/// The description of a map in the outputs of a run.
const DESCRIPTION: &str = "map.yaml";

/// Reads a map to localize in: a YAML file of nav2's map server, a directory with one, or a saved map.
///
/// # Errors
/// When there is none, or it cannot be read.
pub(super) fn read(path: &Path) -> Result<StoredMap, CommandError> {
    let nav2 = |path: &Path| read_nav2_map(path).map_err(CommandError::user);
    if path.is_file() {
        return nav2(path);
    }
    if path.join(DESCRIPTION).is_file() {
        return nav2(&path.join(DESCRIPTION));
    }
    let saved = SavedMap::at(path);
    if saved.exists() {
        return of_saved(saved);
    }
    Err(CommandError::user(format!(
        "{}: there is no map to localize in: give a saved map, the outputs of a run, or a nav2 map.yaml",
        path.display()
    )))
}

/// The fused map of a saved map: a run without a source makes it, in a directory of its own.
fn of_saved(map: SavedMap) -> Result<StoredMap, CommandError> {
    let out = std::env::temp_dir().join(format!("flockslam-known-{}", std::process::id()));
    let configuration =
        ConfigurationArgs { config: None, assignments: Vec::new(), profile: Profile::Default };
    let args = RunArgs {
        out: out.clone(),
        rate: None,
        live: false,
        localize: None,
        robot: None,
        metrics_port: None,
        configuration,
    };
    let run = Run { source: Source::Nothing, world: None, scans: None, continues: Some(map) };
    let outcome = run_set(&args, run);
    let read = outcome.and_then(|_| read_nav2_map(&out.join(DESCRIPTION)).map_err(CommandError::user));
    let removed = std::fs::remove_dir_all(&out).map_err(CommandError::failed);
    let map = read?;
    removed.map(|()| map)
}

/// Whether a set can go on with what a killed one of its name has left. What it knew of a robot in another known map is forgotten.
///
/// # Errors
/// When the killed set was making a map, and this one is to localize.
pub(super) fn fits_killed_set(runtime: &RuntimeDir, known: Option<&StoredMap>) -> Result<bool, CommandError> {
    let left = SetFile::read(&runtime.configuration()).map_err(SetError::from)?;
    let fits = match (left.options.localizes, known) {
        (false, None) => true,
        (false, Some(_)) => {
            return Err(CommandError::user(format!(
                "{}: a killed set left a map that it was making; start it without --localize, or remove the directory",
                runtime.path().display()
            )));
        }
        (true, None) => false,
        (true, Some(known)) => left_map(runtime).is_some_and(|left| left == *known),
    };
    if !fits {
        runtime.forget_state().map_err(CommandError::failed)?;
    }
    Ok(fits)
}

/// The map that a killed set localized in.
fn left_map(runtime: &RuntimeDir) -> Option<StoredMap> {
    let reader = MapReader::open_file(runtime.results().join(KNOWN_MAP)).ok()?;
    let shape = reader.shape();
    let mut map = StoredMap::of_width(shape.width, shape.cell_size_m, shape.origin);
    reader.for_each_row(|row| map.push_row(row)).ok()?;
    Some(map)
}

/// Puts a map where the stages of a set look for it.
///
/// # Errors
/// When the disk refuses.
pub(super) fn put(map: &StoredMap, runtime: &RuntimeDir) -> Result<(), CommandError> {
    let path: PathBuf = runtime.results().join(KNOWN_MAP);
    replace_file_by(&path, |file| write_map_file(file, map), Durability::Process)
        .map_err(CommandError::failed)
}
