//! Which of several processes of a stage is active: a file lock decides.

use crate::{Mode, StageContext, StageError};
use flockslam_bus::{Listener, Notifier};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

/// A process on standby looks this often without a notification.
const LOOK: Duration = Duration::from_millis(100);

/// The right to be the active process of a stage: a lock on a file. The kernel takes it
/// from a process that ends, however it ends, and gives it to the next one at once.
pub struct LeaderLock {
    ours: Arc<AtomicBool>,
    // Held as long as the process lives.
    _file: Arc<File>,
}

impl LeaderLock {
    /// Asks for the lock of the stage. While another process holds it, a thread waits for the end of that process and then notifies the
    /// stage's event.
    ///
    /// # Errors
    /// When the lock cannot be had for another reason than that.
    pub fn ask(context: &StageContext) -> Result<Self, StageError> {
        let path = turn_file(&context.status_dir, context.stage.name());
        let options = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let file = Arc::new(options.map_err(|e| StageError::file(&path, e))?);
        let ours = Arc::new(AtomicBool::new(false));
        match file.try_lock() {
            Ok(()) => take(&file, &ours),
            Err(TryLockError::WouldBlock) => {
                let (file, ours, join) = (Arc::clone(&file), Arc::clone(&ours), context.joiner());
                let event = context.stage.name();
                let waits = move || {
                    let bus = join();
                    let event = bus.as_ref().and_then(|bus| bus.notifier(event).ok());
                    while let Err(error) = file.lock() {
                        if error.kind() != std::io::ErrorKind::Interrupted {
                            tracing::error!(%error, "the turn cannot be waited for");
                            return;
                        }
                    }
                    take(&file, &ours);
                    event.iter().for_each(Notifier::notify);
                };
                let started = thread::Builder::new().name("turn".to_owned()).spawn(waits);
                started.map_err(|e| StageError::file(&path, e))?;
            }
            Err(TryLockError::Error(error)) => return Err(StageError::file(&path, error)),
        }
        Ok(Self { ours, _file: file })
    }

    /// Whether this process is the active one.
    pub fn is_ours(&self) -> bool {
        self.ours.load(Ordering::Acquire)
    }

    /// Is on standby until the lock is free: `follow` is called after each notification, and gives the number of scans that it
    /// has followed. False when the process shall end instead.
    ///
    /// # Errors
    /// The error that `follow` could not recover from.
    pub fn stand_by(
        &self,
        context: &mut StageContext,
        event: &Listener,
        mut follow: impl FnMut(&mut StageContext) -> Result<u64, StageError>,
    ) -> Result<bool, StageError> {
        if self.is_ours() {
            return Ok(true);
        }
        context.ready();
        while context.mode == Mode::Exact {
            // A death ends an exact replay, so there is nothing to follow and nothing to take over.
            if context.stop.is_set() {
                return Ok(false);
            }
            context.alive();
            thread::sleep(LOOK);
        }
        while !self.is_ours() {
            if context.stop.is_set() {
                return Ok(false);
            }
            let followed = follow(context)?;
            context.followed(followed);
            event.wait(LOOK)?;
        }
        tracing::info!(stage = context.stage.name(), replica = context.replica, "takes over");
        Ok(true)
    }
}

fn take(mut file: &File, ours: &AtomicBool) {
    // Only a note for the supervisor: it stops this process last.
    let _ = file.set_len(0);
    let _ = file.seek(SeekFrom::Start(0));
    let _ = file.write_all(std::process::id().to_string().as_bytes());
    ours.store(true, Ordering::Release);
}

fn turn_file(status_dir: &Path, stage: &str) -> PathBuf {
    status_dir.join(format!("{stage}.turn"))
}

/// The active process of a stage, as far as is known.
pub fn leader(status_dir: &Path, stage: &str) -> Option<u32> {
    std::fs::read_to_string(turn_file(status_dir, stage)).ok()?.trim().parse().ok()
}
