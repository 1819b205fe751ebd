//! A set's folder on disk, for what grows as it drives.

use super::{
    KEPT_MARK, LOCK_FILE, RuntimeDir, RuntimeError, entries, file_name, io_error, remove, take_lock,
    take_turn,
};
use std::fs;
use std::path::{Path, PathBuf};

/// Begins the names of folders on disk that belong to sets.
const SPILL_PREFIX: &str = "flockslam-spill-";
/// In a set's directory: leads to its folder on disk.
const SPILL_LINK: &str = "spill";

impl RuntimeDir {
    /// Makes the set's folder on disk, and a link to it by which stages and sweepers find it.
    pub(super) fn spill_into(&mut self, spill_dir: &Path) -> Result<(), RuntimeError> {
        let refused = |path: &Path, source| RuntimeError::Spill { path: path.to_owned(), source };
        let spill_dir = std::path::absolute(spill_dir).map_err(|source| refused(spill_dir, source))?;
        let folder = spill_dir.join(format!("{SPILL_PREFIX}{}", self.name));
        fs::create_dir_all(&spill_dir).map_err(|source| refused(&folder, source))?;
        // Sets of other containers, with a shared memory of their own, may share the disk.
        let turn = take_turn(&spill_dir);
        sweep_spilled(&spill_dir);
        fs::create_dir_all(&folder).map_err(|source| refused(&folder, source))?;
        let lock = take_lock(&folder).map_err(|error| match error {
            RuntimeError::Io { path, source } => refused(&path, source),
            other => other,
        })?;
        drop(turn);
        // So may a set of the same name.
        self._spill_lock = Some(lock.ok_or_else(|| RuntimeError::Running(self.name.clone()))?);
        // One that was killed, and cannot be gone on with, may have left something.
        entries(&folder).iter().filter(|path| file_name(path) != LOCK_FILE).for_each(|path| remove(path));
        let link = self.path.join(SPILL_LINK);
        std::os::unix::fs::symlink(&folder, &link).map_err(|source| io_error(&link, source))?;
        self.spill = folder;
        Ok(())
    }
}

/// Removes the folders of sets that are dead. Those of sets that are kept for the next of their name stay until the machine is
/// restarted, which ends the other half of them.
fn sweep_spilled(spill_dir: &Path) {
    let boot = boot();
    for folder in entries(spill_dir) {
        let is_spill = file_name(&folder).starts_with(SPILL_PREFIX) && folder.join(LOCK_FILE).exists();
        let is_kept = || fs::read_to_string(folder.join(KEPT_MARK)).is_ok_and(|mark| mark == boot);
        if is_spill
            && !is_kept()
            && let Ok(Some(_lock)) = take_lock(&folder)
        {
            remove(&folder);
        }
    }
}

/// The folder on disk of the set in a directory.
pub(super) fn spill_folder(path: &Path) -> Option<PathBuf> {
    let folder = fs::read_link(path.join(SPILL_LINK)).ok()?;
    file_name(&folder).starts_with(SPILL_PREFIX).then_some(folder)
}

/// Tells this run of the machine from those before it.
pub(super) fn boot() -> String {
    fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default()
}
