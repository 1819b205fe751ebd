use crate::BusError;
use iceoryx2::config::Config;
use iceoryx2::prelude::{FilePath, SemanticString};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Where POSIX shared memory objects appear as files.
const SHARED_MEMORY: &str = "/dev/shm";
const DIRECTORY_PREFIX: &str = "flockslam-";
const LOCK_FILE: &str = "lock";

/// Why a set's runtime directory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// Another set of this name runs.
    #[error("a process set named {0} is already running on this machine")]
    Running(String),
    /// The name cannot be part of a file name.
    #[error("'{0}' cannot name a process set: use letters, digits and '-', at most 40")]
    BadName(String),
    /// The system refused.
    #[error("{path}: {source}")]
    Io {
        /// What was being touched.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// Everything that a process set keeps in memory outside its processes: one directory on tmpfs and the shared-memory
/// objects with its prefix. State lives here, not in a process that may die.
pub struct RuntimeDir {
    path: PathBuf,
    name: String,
    // Held for as long as the set lives: the lock goes with the process, whatever kills it.
    lock: Option<File>,
}

impl RuntimeDir {
    /// Cold start: takes the lock, removes what an earlier set of this name left, creates the directories.
    ///
    /// # Errors
    /// When a set of this name runs, or the system refuses.
    pub fn create(name: &str) -> Result<Self, RuntimeError> {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '-';
        if name.is_empty() || name.len() > 40 || !name.chars().all(good) {
            return Err(RuntimeError::BadName(name.to_owned()));
        }
        let path = Path::new(SHARED_MEMORY).join(format!("{DIRECTORY_PREFIX}{name}"));
        let turn = take_turn();
        sweep_abandoned();
        fs::create_dir_all(&path).map_err(|source| io_error(&path, source))?;
        let lock = take_lock(&path)?.ok_or_else(|| RuntimeError::Running(name.to_owned()))?;
        drop(turn);
        let runtime = Self { path, name: name.to_owned(), lock: Some(lock) };
        runtime.wipe_contents();
        for directory in
            [runtime.bus(), runtime.journal(), runtime.submaps(), runtime.status(), runtime.results()]
        {
            fs::create_dir_all(&directory).map_err(|source| io_error(&directory, source))?;
        }
        runtime.write_bus_configuration()?;
        Ok(runtime)
    }

    /// The directory of a set that somebody else created.
    ///
    /// # Errors
    /// When there is none at `path`.
    pub fn open(path: &Path) -> Result<Self, RuntimeError> {
        fs::metadata(path.join(LOCK_FILE)).map_err(|source| io_error(path, source))?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let name = name.strip_prefix(DIRECTORY_PREFIX).unwrap_or(&name).to_owned();
        Ok(Self { path: path.to_owned(), name, lock: None })
    }

    /// The directory itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Scans and poses since the start of the epoch.
    pub fn journal(&self) -> PathBuf {
        self.path.join("journal")
    }

    /// Closed submaps.
    pub fn submaps(&self) -> PathBuf {
        self.path.join("submaps")
    }

    /// Heartbeats, metrics sockets and reports of the stages.
    pub fn status(&self) -> PathBuf {
        self.path.join("status")
    }

    /// What sync-manager concluded: layout, trajectories, fused map.
    pub fn results(&self) -> PathBuf {
        self.path.join("results")
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

    fn object_prefix(&self) -> String {
        format!("fs-{}_", self.name)
    }

    fn write_bus_configuration(&self) -> Result<(), RuntimeError> {
        let path = self.path.join("iceoryx2.toml");
        let text = format!(
            "[global]\nroot-path = \"{}\"\nprefix = \"{}\"\ncreation-timeout = {{ secs = 0, nanos = 300000000 }}\n",
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
        if self.lock.is_some() {
            let _turn = take_turn();
            self.wipe_contents();
            remove(&self.path);
        }
    }
}

/// Removes what sets left whose supervisor was killed: nobody holds their lock.
fn sweep_abandoned() {
    for path in entries(Path::new(SHARED_MEMORY)) {
        let Some(name) = file_name(&path).strip_prefix(DIRECTORY_PREFIX).map(str::to_owned) else { continue };
        if !path.join(LOCK_FILE).exists() {
            continue;
        }
        if let Ok(Some(lock)) = take_lock(&path) {
            RuntimeDir { path, name, lock: Some(lock) }.remove();
        }
    }
}

/// Held while sets are created or removed: a sweeper must not meet a directory whose lock is about to be taken, nor a
/// creator one that is about to go. A system without such locks only loses that safety.
fn take_turn() -> Option<File> {
    let turn = File::open(SHARED_MEMORY).ok()?;
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
    entries(directory).into_iter().map(size).sum()
}

fn io_error(path: &Path, source: io::Error) -> RuntimeError {
    RuntimeError::Io { path: path.to_owned(), source }
}
