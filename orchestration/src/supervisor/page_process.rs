//! The process of the live page, as the supervisor handles it: it is started, started again when it dies, and killed with the set.

use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A page that died is started again after this.
const PAUSE: Duration = Duration::from_secs(1);

/// The process that serves the live page of a set. It is no stage: nothing depends on it.
pub struct PageProcess {
    executable: PathBuf,
    set_dir: PathBuf,
    child: Option<Child>,
    /// When it is started, while there is none.
    due: Instant,
}

impl PageProcess {
    /// The page of the set in `set_dir`.
    ///
    /// # Errors
    /// When the system does not say what the executable is.
    pub fn start(set_dir: &Path) -> std::io::Result<Self> {
        let executable = std::env::current_exe()?;
        let mut page = Self { executable, set_dir: set_dir.to_owned(), child: None, due: Instant::now() };
        page.look_after();
        Ok(page)
    }

    /// Starts it again when it has died.
    pub fn look_after(&mut self) {
        if let Some(child) = &mut self.child {
            match child.try_wait() {
                Ok(None) => return,
                ended => tracing::warn!(?ended, "the page has died and is started again"),
            }
            (self.child, self.due) = (None, Instant::now() + PAUSE);
        }
        if self.due <= Instant::now() {
            self.spawn();
        }
    }

    /// Starts it anew: what it has seen is no longer so.
    pub fn restart(&mut self) {
        self.end();
        self.due = Instant::now();
    }

    fn spawn(&mut self) {
        let mut command = Command::new(&self.executable);
        command.arg("page").arg("--set-dir").arg(&self.set_dir);
        command.arg("--parent").arg(std::process::id().to_string());
        command.stdin(Stdio::null()).stdout(Stdio::null());
        match command.spawn() {
            Ok(child) => self.child = Some(child),
            Err(error) => {
                tracing::warn!(%error, "the page cannot be started");
                self.due = Instant::now() + PAUSE;
            }
        }
    }

    fn end(&mut self) {
        if let Some(mut child) = self.child.take() {
            let pid = rustix::process::Pid::from_child(&child);
            let _ = rustix::process::kill_process(pid, Signal::KILL);
            let _ = child.wait();
        }
    }
}

impl Drop for PageProcess {
    fn drop(&mut self) {
        self.end();
    }
}
