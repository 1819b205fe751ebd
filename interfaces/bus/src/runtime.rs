//! The runtime directory of a set: it is created under a lock, joined by the stages, taken over after a kill, and removed at
//! the end together with the shared-memory objects of the set.

use crate::BusError;
use crate::room::SHARED_MEMORY;
use iceoryx2::config::Config;
use iceoryx2::prelude::{FilePath, SemanticString};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

mod folder_on_disk;

use folder_on_disk::{boot, spill_folder};

/// A living process gives a shared object that it has begun its size within this.
const FINISHED_WITHIN: Duration = Duration::from_millis(20);
const DIRECTORY_PREFIX: &str = "flockslam-";
const LOCK_FILE: &str = "lock";
/// In a set's directory: its state outlives the supervisor, for the next set of its name.
const KEPT_MARK: &str = "kept";
/// Of the status of a dead set only this is of use to the next: how far the source had come.
const CURSOR_ENDING: &str = ".cursor";

/// The name of a set is part of that of everything that iceoryx2 opens: with 22 letters all stages start, with 23 none does (tried with
/// iceoryx2 0.10).
const NAME_MAX: usize = 22;

/// Why a set's runtime directory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// Another set of this name runs.
    #[error("a process set named {0} is already running on this machine")]
    Running(String),
    /// The name cannot be part of a file name, or is too long.
    #[error("'{0}' cannot name a process set: use letters, digits and '-', at most {NAME_MAX}")]
    BadName(String),
    /// The folder on disk for large, rarely read data cannot be used.
    #[error("set.spill_dir: {path}: {source}")]
    Spill {
        /// What was being touched.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The system refused.
    #[error("{path}: {source}")]
    Io {
        /// What was being touched.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
}

/// Everything that a process set keeps in memory outside its processes: one directory on tmpfs and the shared-memory
/// objects with its prefix. State lives here, not in a process that may die. What is large and rarely read may lie in a folder on
/// disk instead, which comes and goes with the directory.
pub struct RuntimeDir {
    path: PathBuf,
    name: String,
    spill: PathBuf,
    // Held for as long as the set lives: the locks go with the process, whatever kills it.
    lock: Option<File>,
    _spill_lock: Option<File>,
    /// Everything goes when this is dropped.
    wiped_at_end: bool,
}

impl RuntimeDir {
    /// Cold start: takes the lock, removes what an earlier set of this name left, creates the directories.
    ///
    /// # Errors
    /// When a set of this name runs, or the system refuses.
    pub fn create(name: &str) -> Result<Self, RuntimeError> {
        Self::create_spilling(name, None)
    }

    /// As [`RuntimeDir::create`], with a folder for the set in `spill_dir`, which is made when it is not there. Folders that dead
    /// sets left there are removed.
    ///
    /// # Errors
    /// When a set of this name runs, the folder cannot be made or written, or the system refuses.
    pub fn create_spilling(name: &str, spill_dir: Option<&Path>) -> Result<Self, RuntimeError> {
        if !is_good_name(name) {
            return Err(RuntimeError::BadName(name.to_owned()));
        }
        let path = Self::path_of(name);
        let turn = take_turn(Path::new(SHARED_MEMORY));
        sweep_abandoned();
        fs::create_dir_all(&path).map_err(|source| io_error(&path, source))?;
        let lock = take_lock(&path)?.ok_or_else(|| RuntimeError::Running(name.to_owned()))?;
        drop(turn);
        let mut runtime = Self {
            spill: path.clone(),
            path,
            name: name.to_owned(),
            lock: Some(lock),
            _spill_lock: None,
            wiped_at_end: true,
        };
        runtime.wipe_contents();
        if let Some(spill_dir) = spill_dir {
            runtime.spill_into(spill_dir)?;
        }
        runtime.make_directories()?;
        Ok(runtime)
    }

    /// As [`RuntimeDir::create_spilling`], for a set whose state shall outlive its supervisor. When one of this name was killed, its
    /// journal, submaps, results and source cursor are taken over, and only what has to do with its processes is removed: true.
    ///
    /// # Errors
    /// As [`RuntimeDir::create_spilling`].
    pub fn create_or_take_over(name: &str, spill_dir: Option<&Path>) -> Result<(Self, bool), RuntimeError> {
        let path = Self::path_of(name);
        let has_all = || spill_folder(&path).is_none_or(|folder| folder.join(LOCK_FILE).exists());
        let left = is_good_name(name)
            && path.join(KEPT_MARK).exists()
            && path.join("set.json").exists()
            && has_all();
        let runtime =
            if left { Self::take_over(name, path)? } else { Self::create_spilling(name, spill_dir)? };
        let boot = boot();
        for directory in [&runtime.path, &runtime.spill] {
            let mark = directory.join(KEPT_MARK);
            fs::write(&mark, &boot).map_err(|source| io_error(&mark, source))?;
        }
        Ok((runtime, left))
    }

    fn take_over(name: &str, path: PathBuf) -> Result<Self, RuntimeError> {
        let running = || RuntimeError::Running(name.to_owned());
        let lock = take_lock(&path)?.ok_or_else(running)?;
        let spill = spill_folder(&path);
        let spill_lock = match &spill {
            Some(folder) => Some(take_lock(folder)?.ok_or_else(running)?),
            None => None,
        };
        let runtime = Self {
            spill: spill.unwrap_or_else(|| path.clone()),
            name: name.to_owned(),
            lock: Some(lock),
            _spill_lock: spill_lock,
            // Until it is known that it is not needed any more.
            wiped_at_end: false,
            path,
        };
        remove(&runtime.bus());
        remove_objects(&runtime.object_prefix());
        for entry in entries(&runtime.status()) {
            if !file_name(&entry).ends_with(CURSOR_ENDING) {
                remove(&entry);
            }
        }
        runtime.make_directories()?;
        Ok(runtime)
    }

    fn make_directories(&self) -> Result<(), RuntimeError> {
        for directory in [self.bus(), self.journal(), self.submaps(), self.status(), self.results()] {
            fs::create_dir_all(&directory).map_err(|source| io_error(&directory, source))?;
        }
        self.write_bus_configuration()
    }

    /// The directory of the set of this name, whether it runs or not.
    pub fn path_of(name: &str) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{DIRECTORY_PREFIX}{name}"))
    }

    /// Names of all sets that run on this machine.
    pub fn running() -> Vec<String> {
        let name = |path: &PathBuf| file_name(path).strip_prefix(DIRECTORY_PREFIX).map(str::to_owned);
        let held = |path: &PathBuf| {
            File::open(path.join(LOCK_FILE)).is_ok_and(|lock| lock.try_lock_shared().is_err())
        };
        let mut names: Vec<_> =
            entries(Path::new(SHARED_MEMORY)).iter().filter(|path| held(path)).filter_map(name).collect();
        names.sort();
        names
    }

    /// The directory of a set that another process created.
    ///
    /// # Errors
    /// When there is none at `path`.
    pub fn open(path: &Path) -> Result<Self, RuntimeError> {
        fs::metadata(path.join(LOCK_FILE)).map_err(|source| io_error(path, source))?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let name = name.strip_prefix(DIRECTORY_PREFIX).unwrap_or(&name).to_owned();
        let spill = spill_folder(path).unwrap_or_else(|| path.to_owned());
        Ok(Self { path: path.to_owned(), name, spill, lock: None, _spill_lock: None, wiped_at_end: false })
    }

    /// Removes the state of the stages: journal, submaps, results, and the source's cursor.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn remove_state(&self) -> Result<(), RuntimeError> {
        let cursors =
            entries(&self.status()).into_iter().filter(|path| file_name(path).ends_with(CURSOR_ENDING));
        cursors.for_each(|path| remove(&path));
        for directory in [self.journal(), self.submaps(), self.results()] {
            fs::remove_dir_all(&directory)
                .and_then(|()| fs::create_dir_all(&directory))
                .map_err(|source| io_error(&directory, source))?;
        }
        Ok(())
    }

    /// Whether everything goes when this is dropped, or stays for the next set of this name.
    pub fn wipe_at_end(&mut self, wipes: bool) {
        self.wiped_at_end = wipes;
    }

    /// The name of the set.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where the supervisor of the set takes orders.
    pub fn control_socket(&self) -> PathBuf {
        self.path.join("control")
    }

    /// The directory itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Scans and poses since the start of the run.
    pub fn journal(&self) -> PathBuf {
        self.spill.join("journal")
    }

    /// Directory of large, rarely read data: the set's folder on disk, or the directory itself when there is none.
    pub fn spill(&self) -> &Path {
        &self.spill
    }

    /// Closed submaps.
    pub fn submaps(&self) -> PathBuf {
        self.spill.join("submaps")
    }

    /// Heartbeats, metrics sockets and reports of the stages.
    pub fn status(&self) -> PathBuf {
        self.path.join("status")
    }

    /// Results of sync-manager: solution, trajectories, fused map.
    pub fn results(&self) -> PathBuf {
        self.spill.join("results")
    }

    /// The configuration of the set, as its stages read it.
    pub fn configuration(&self) -> PathBuf {
        self.path.join("set.json")
    }

    /// Bytes of memory that shared-memory objects and files of the set really occupy.
    pub fn occupied_bytes(&self) -> u64 {
        let objects = entries(Path::new(SHARED_MEMORY))
            .into_iter()
            .filter(|path| file_name(path).starts_with(&self.object_prefix()))
            .map(|path| allocated_bytes(&path));
        objects.sum::<u64>() + directory_bytes(&self.path)
    }

    /// Removes shared objects that a process began and gave no size, since it was killed in between; gives how many. iceoryx2 0.10
    /// waits for such an object without end, also while it cleans up after the dead. A process that lives takes microseconds to get
    /// past this state, so what is still in it after a while is nobody's.
    pub fn remove_unfinished_objects(&self) -> usize {
        let unfinished = || -> Vec<(PathBuf, u64)> {
            let own = entries(Path::new(SHARED_MEMORY)).into_iter();
            let own = own.filter(|path| file_name(path).starts_with(&self.object_prefix()));
            own.filter_map(|path| {
                let metadata = fs::metadata(&path).ok()?;
                (metadata.len() == 0).then(|| (path, metadata.ino()))
            })
            .collect()
        };
        let before = unfinished();
        if before.is_empty() {
            return 0;
        }
        std::thread::sleep(FINISHED_WITHIN);
        let after = unfinished();
        let left = before.iter().filter(|object| after.contains(object));
        left.filter(|(path, _)| fs::remove_file(path).is_ok()).count()
    }

    /// Points iceoryx2 at this set; must come before any other use of it in a process.
    pub(crate) fn configure_shared_memory(&self) -> Result<(), BusError> {
        let file = self.path.join("iceoryx2.toml");
        let setup = |reason: String| BusError::Setup { place: file.display().to_string(), reason };
        let path = FilePath::new(file.to_string_lossy().as_bytes()).map_err(|e| setup(format!("{e:?}")))?;
        iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Fatal);
        let config = Config::setup_global_config_from_file(&path).map_err(|e| setup(format!("{e:?}")))?;
        let root = config.global.root_path().to_string();
        if Path::new(&root) == self.bus() {
            Ok(())
        } else {
            Err(setup(format!("this process already belongs to the set in {root}")))
        }
    }

    fn bus(&self) -> PathBuf {
        self.path.join("bus")
    }

    /// Where iceoryx2 keeps the nodes of this set.
    pub(crate) fn nodes(&self) -> PathBuf {
        self.bus().join("nodes")
    }

    /// Begins the names of all shared objects of this set.
    pub(crate) fn object_prefix(&self) -> String {
        format!("fs-{}_", self.name)
    }

    fn write_bus_configuration(&self) -> Result<(), RuntimeError> {
        let path = self.path.join("iceoryx2.toml");
        // A subscriber lays out 3.6 kB for every connection that may outlive its publisher; 128 of them by default.
        let text = format!(
            "[global]\nroot-path = \"{}\"\nprefix = \"{}\"\ncreation-timeout = {{ secs = 0, nanos = 300000000 }}\n\
             [defaults.publish-subscribe]\nsubscriber-expired-connection-buffer = 16\n",
            self.bus().display(),
            self.object_prefix()
        );
        let mut file = File::create(&path).map_err(|source| io_error(&path, source))?;
        file.write_all(text.as_bytes()).map_err(|source| io_error(&path, source))
    }

    fn remove(mut self) {
        self.wipe_contents();
        remove(&self.path);
        self.lock = None;
    }

    fn wipe_contents(&self) {
        if let Some(folder) = spill_folder(&self.path).filter(|folder| folder.exists()) {
            remove(&folder);
        }
        for entry in entries(&self.path) {
            if file_name(&entry) != LOCK_FILE {
                remove(&entry);
            }
        }
        remove_objects(&self.object_prefix());
    }
}

impl Drop for RuntimeDir {
    fn drop(&mut self) {
        if self.lock.is_some() && self.wiped_at_end {
            let _turn = take_turn(Path::new(SHARED_MEMORY));
            self.wipe_contents();
            remove(&self.path);
        }
    }
}

fn is_good_name(name: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || c == '-';
    !name.is_empty() && name.len() <= NAME_MAX && name.chars().all(good)
}

/// Removes the remains of sets whose supervisor was killed, so that no process holds their lock. Sets that are kept for the next of their name stay.
fn sweep_abandoned() {
    for path in entries(Path::new(SHARED_MEMORY)) {
        let Some(name) = file_name(&path).strip_prefix(DIRECTORY_PREFIX).map(str::to_owned) else { continue };
        if !path.join(LOCK_FILE).exists() || path.join(KEPT_MARK).exists() {
            continue;
        }
        if let Ok(Some(lock)) = take_lock(&path) {
            let spill = path.clone();
            RuntimeDir { spill, path, name, lock: Some(lock), _spill_lock: None, wiped_at_end: true }
                .remove();
        }
    }
}

/// Held while sets are created or removed in a directory: a sweeper must not meet a directory whose lock is about to be taken, nor a
/// creator one that is about to go. A system without such locks only loses that safety.
fn take_turn(directory: &Path) -> Option<File> {
    let turn = File::open(directory).ok()?;
    turn.lock().ok()?;
    Some(turn)
}

fn take_lock(directory: &Path) -> Result<Option<File>, RuntimeError> {
    let path = directory.join(LOCK_FILE);
    let opened = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
    let file = opened.map_err(|source| io_error(&path, source))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(fs::TryLockError::WouldBlock) => Ok(None),
        Err(fs::TryLockError::Error(source)) => Err(io_error(&path, source)),
    }
}

fn entries(directory: &Path) -> Vec<PathBuf> {
    let Ok(reader) = fs::read_dir(directory) else { return Vec::new() };
    reader.filter_map(|entry| entry.ok().map(|entry| entry.path())).collect()
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

fn remove(path: &Path) {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    if let Err(error) = removed {
        tracing::warn!(path = %path.display(), %error, "cannot remove");
    }
}

fn remove_objects(prefix: &str) {
    for path in entries(Path::new(SHARED_MEMORY)) {
        if file_name(&path).starts_with(prefix) {
            remove(&path);
        }
    }
}

fn allocated_bytes(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |metadata| metadata.blocks() * 512)
}

fn directory_bytes(directory: &Path) -> u64 {
    let size = |path: PathBuf| if path.is_dir() { directory_bytes(&path) } else { allocated_bytes(&path) };
    // What a link leads to is on disk.
    entries(directory).into_iter().filter(|path| !path.is_symlink()).map(size).sum()
}

fn io_error(path: &Path, source: io::Error) -> RuntimeError {
    RuntimeError::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests;
