//! The map that a set shall localize in: a saved map, the outputs of a run, or a map of somebody else. It is only read.

use super::CommandError;
use crate::store::{SavedMap, read_nav2_map};
use crate::supervisor::{SetError, SetFile};
use flockslam_bus::RuntimeDir;
use flockslam_journal::{Durability, replace_file_by};
use flockslam_results::{KNOWN_MAP, MapReader, StoredMap, write_map_file};
use std::path::{Path, PathBuf};
use std::process::Command;

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
    if SavedMap::at(path).exists() {
        return of_saved(path);
    }
    Err(CommandError::user(format!(
        "{}: there is no map to localize in: give a saved map, the outputs of a run, or a nav2 map.yaml",
        path.display()
    )))
}

/// The fused map of a saved map: `store export` makes it in a process of its own, since a process belongs to one set only.
fn of_saved(map: &Path) -> Result<StoredMap, CommandError> {
    let out = std::env::temp_dir().join(format!("flockslam-known-{}", std::process::id()));
    let executable = std::env::current_exe().map_err(CommandError::failed)?;
    let exported =
        Command::new(executable).args(["store", "export"]).arg(map).arg("--out").arg(&out).output();
    let exported = exported.map_err(CommandError::failed)?;
    let read = if exported.status.success() {
        read_nav2_map(&out.join(DESCRIPTION)).map_err(CommandError::user)
    } else {
        let said = String::from_utf8_lossy(&exported.stderr);
        let reason = said.lines().last().unwrap_or("its export ended").trim_start_matches("flockslam: ");
        Err(CommandError::user(format!("{}: {reason}", map.display())))
    };
    // What it has written is of no more use.
    let _ = std::fs::remove_dir_all(&out);
    read
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
