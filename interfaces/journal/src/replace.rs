//! Atomic replacement of whole files: the bytes go into a file beside the old one, which is then renamed.

use crate::JournalError;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// What a replaced file survives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// The death of the process: enough on tmpfs and for what can be made again.
    Process,
    /// A loss of power too: file and directory are synced to disk, which may take long.
    Power,
}

const SUFFIX: &str = ".flocktmp";
static COUNTER: AtomicU64 = AtomicU64::new(0);

/// Replaces the file at `path` by one with these bytes, or makes it: a reader of the path at any instant, also after
/// a kill, finds the whole old or the whole new file.
///
/// # Errors
/// When the disk refuses; the old file is then untouched.
pub fn replace_file(path: &Path, bytes: &[u8], durability: Durability) -> Result<(), JournalError> {
    replace_file_by_parts(path, &[bytes], durability)
}

/// As [`replace_file`], for bytes that lie in several places: large ones need not be copied together.
///
/// # Errors
/// As [`replace_file`].
pub fn replace_file_by_parts(
    path: &Path,
    parts: &[&[u8]],
    durability: Durability,
) -> Result<(), JournalError> {
    replace_file_by(path, |file| parts.iter().try_for_each(|bytes| file.write_all(bytes)), durability)
}

/// As [`replace_file`], for bytes that `write` makes one after the other: they need not lie in memory together.
///
/// # Errors
/// As [`replace_file`], and when `write` fails.
pub fn replace_file_by(
    path: &Path,
    write: impl FnOnce(&mut File) -> io::Result<()>,
    durability: Durability,
) -> Result<(), JournalError> {
    let temporary = temporary_of(path)?;
    let replaced = write_new(&temporary, write, durability)
        .and_then(|()| fs::rename(&temporary, path))
        .map_err(JournalError::io("replace", path));
    if replaced.is_err() {
        let _ = fs::remove_file(&temporary);
        return replaced;
    }
    if durability == Durability::Power {
        let directory = directory_of(path);
        File::open(directory).and_then(|d| d.sync_all()).map_err(JournalError::io("sync", directory))?;
    }
    Ok(())
}

/// Removes what [`replace_file`] calls of processes that no longer run left unfinished in a directory; gives their
/// number. To be called at a start.
///
/// # Errors
/// When the directory cannot be listed.
pub fn remove_leftovers(directory: &Path) -> Result<usize, JournalError> {
    let entries = fs::read_dir(directory).map_err(JournalError::io("list", directory))?;
    let mut removed = 0;
    for entry in entries {
        let name = entry.map_err(JournalError::io("list", directory))?.file_name();
        if writer_of(&name).is_some_and(|pid| !Path::new("/proc").join(pid.to_string()).exists()) {
            removed += usize::from(fs::remove_file(directory.join(&name)).is_ok());
        }
    }
    Ok(removed)
}

/// In the same directory, since only there a rename is atomic; of a name that no other writer uses.
fn temporary_of(path: &Path) -> Result<PathBuf, JournalError> {
    let name = path.file_name().ok_or_else(|| {
        JournalError::io("replace", path)(io::Error::new(io::ErrorKind::InvalidInput, "it has no file name"))
    })?;
    let mut temporary = OsString::from(".");
    temporary.push(name);
    let count = COUNTER.fetch_add(1, Ordering::Relaxed);
    temporary.push(format!(".{}.{count}{SUFFIX}", std::process::id()));
    Ok(path.with_file_name(temporary))
}

/// The process that a temporary file belongs to; `None` for all other names.
fn writer_of(name: &OsStr) -> Option<u32> {
    let mut fields = name.to_str()?.strip_prefix('.')?.strip_suffix(SUFFIX)?.rsplit('.');
    fields.next()?.parse::<u64>().ok()?;
    fields.next()?.parse().ok()
}

fn write_new(
    path: &Path,
    write: impl FnOnce(&mut File) -> io::Result<()>,
    durability: Durability,
) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create(true).truncate(true).open(path)?;
    write(&mut file)?;
    if durability == Durability::Power { file.sync_all() } else { Ok(()) }
}

fn directory_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(directory: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(directory).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_made_and_replaced_without_a_trace() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map.pgm");
        for (bytes, durability) in [(&b"old"[..], Durability::Process), (b"newer", Durability::Power)] {
            replace_file(&path, bytes, durability).unwrap();
            assert_eq!(fs::read(&path).unwrap(), bytes);
        }
        assert_eq!(names(dir.path()), ["map.pgm"]);
    }

    #[test]
    fn a_refusal_leaves_the_old_state_and_no_remains() {
        let dir = tempfile::tempdir().unwrap();
        let taken = dir.path().join("taken");
        fs::create_dir(&taken).unwrap();
        let error = replace_file(&taken, b"x", Durability::Process).unwrap_err();
        assert!(error.to_string().contains("taken"), "{error}");
        assert_eq!(names(dir.path()), ["taken"]);
        assert!(replace_file(&dir.path().join("none/x"), b"x", Durability::Process).is_err());
        assert!(replace_file(Path::new("/"), b"x", Durability::Process).is_err());
        assert_eq!(names(dir.path()), ["taken"]);
        assert!(taken.is_dir());
    }

    #[test]
    fn a_bare_name_lies_in_the_working_directory() {
        assert_eq!(directory_of(Path::new("map.pgm")), Path::new("."));
        assert_eq!(directory_of(Path::new("/map.pgm")), Path::new("/"));
    }

    #[test]
    fn only_leftovers_of_dead_processes_are_removed() {
        let dir = tempfile::tempdir().unwrap();
        // The largest pid of Linux is 2²², so no process has this one.
        let dead = format!(".map.pgm.4194999.3{SUFFIX}");
        let own = format!(".map.pgm.{}.4{SUFFIX}", std::process::id());
        for name in [&dead, &own, "map.pgm", ".hidden", &format!(".odd{SUFFIX}")] {
            fs::write(dir.path().join(name), b"x").unwrap();
        }
        assert_eq!(remove_leftovers(dir.path()).unwrap(), 1);
        assert_eq!(names(dir.path()).len(), 4);
        assert!(!dir.path().join(dead).exists());
    }
}
