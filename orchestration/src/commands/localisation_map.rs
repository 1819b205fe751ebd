//! The map that a set shall localize in: a saved map, the outputs of a run, or an imported map. It is only read.

use super::CommandError;
use crate::store::{MapHead, SavedMap, read_nav2_map};
use crate::supervisor::{SetError, SetFile};
use flockslam_bus::RuntimeDir;
use flockslam_evidence::Cell;
use flockslam_geometry::Point;
use flockslam_journal::{Durability, replace_file_by};
use flockslam_results::{KNOWN_MAP, MapReader, SetMode, StoredMap, write_map_file};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Side of the cell of a map that is awaited, metres.
const AWAITED_CELL_M: f64 = 0.05;
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

/// The saved map at a place, when it is one that a set with this head can add to; else why not.
///
/// # Errors
/// Why the set cannot make a map in its frame.
pub(super) fn extendable(path: &Path, head: &MapHead) -> Result<SavedMap, String> {
    let saved = SavedMap::at(path);
    if path.is_file() || path.join(DESCRIPTION).is_file() || !saved.exists() {
        return Err(format!("{} is a picture", path.display()));
    }
    let fits = MapHead::read(path).and_then(|found| found.fits(path, head));
    fits.map(|()| saved).map_err(|error| error.to_string())
}

/// A map of one cell of which nothing is known: what a set begins with until a map comes from the graph.
pub(super) fn awaited() -> StoredMap {
    let mut map = StoredMap::of_width(1, AWAITED_CELL_M, Point::default());
    map.push_row(&[Cell::default()]);
    map
}

/// The fused map of a saved map: `store export` makes it in a process of its own, since a process belongs to one set only.
fn of_saved(map: &Path) -> Result<StoredMap, CommandError> {
    let out = std::env::temp_dir().join(format!("flockslam-known-{}", std::process::id()));
    exported(map, &out, None)
}

/// The fused map of a saved map, made in this directory, which is removed, by these settings.
///
/// # Errors
/// When it cannot be made.
pub(super) fn exported(map: &Path, out: &Path, settings: Option<&Path>) -> Result<StoredMap, CommandError> {
    let executable = std::env::current_exe().map_err(CommandError::failed)?;
    let mut command = Command::new(executable);
    command.args(["store", "export"]).arg(map).arg("--out").arg(out);
    if let Some(settings) = settings {
        command.arg("--config").arg(settings);
    }
    let exported = command.output();
    let exported = exported.map_err(CommandError::failed)?;
    let read = if exported.status.success() {
        read_nav2_map(&out.join(DESCRIPTION)).map_err(CommandError::user)
    } else {
        let errors = String::from_utf8_lossy(&exported.stderr);
        let reason = errors.lines().last().unwrap_or("its export ended").trim_start_matches("flockslam: ");
        Err(CommandError::user(format!("{}: {reason}", map.display())))
    };
    // What it has written is of no more use.
    let _ = std::fs::remove_dir_all(out);
    read
}

/// Whether a set can go on with what a killed one of its name has left. What it knew of a robot in another known map is dropped.
///
/// # Errors
/// When the killed set was making a map, and this one is to localize.
pub(super) fn fits_killed_set(runtime: &RuntimeDir, known: Option<&StoredMap>) -> Result<bool, CommandError> {
    let file = SetFile::read(&runtime.configuration()).map_err(SetError::from)?;
    let of_start = SetMode { given: file.options.localizes, ..SetMode::default() };
    let left = SetMode::read(&runtime.results()).unwrap_or(of_start);
    let fits = match (left.given, known) {
        (false, None) => true,
        (false, Some(_)) => {
            return Err(CommandError::user(format!(
                "{}: a killed set left a map that it was making; start it without --localize, or remove the directory",
                runtime.path().display()
            )));
        }
        (true, None) => false,
        // Another node has given it the map, or it was made further.
        (true, Some(known)) if left.changed || *known == awaited() => true,
        (true, Some(known)) => is_known(runtime, known),
    };
    if !fits {
        runtime.remove_state().map_err(CommandError::failed)?;
    }
    Ok(fits)
}

/// Whether a set localizes in this map.
pub(super) fn is_known(runtime: &RuntimeDir, map: &StoredMap) -> bool {
    left_map(runtime).is_some_and(|known| known == *map)
}

/// The map that a set localizes in.
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
