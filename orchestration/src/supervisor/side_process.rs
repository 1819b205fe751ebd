//! A process beside the stages, as the supervisor handles it: it is started, restarted when it ends, and killed with the set.

use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// One that ended is restarted after this.
const PAUSE: Duration = Duration::from_secs(1);

/// A process that serves a set from the side: its live page, its bridge to a ROS graph. It is no stage: nothing depends on it.
pub struct SideProcess {
    executable: PathBuf,
    /// The command of this executable that it runs.
    command: &'static str,
    /// What follows on its command line.
    arguments: Vec<String>,
    set_dir: PathBuf,
    child: Option<Child>,
    /// When it is started, while there is none.
    due: Instant,
}

impl SideProcess {
    /// Runs a command of this executable, with these arguments, for the set in `set_dir`.
    ///
    /// # Errors
    /// When the system does not say what the executable is.
    pub fn start(command: &'static str, set_dir: &Path, arguments: &[String]) -> std::io::Result<Self> {
        let mut process = Self {
            executable: std::env::current_exe()?,
            command,
            arguments: arguments.to_owned(),
            set_dir: set_dir.to_owned(),
            child: None,
            due: Instant::now(),
        };
        process.look_after();
        Ok(process)
    }

    /// Restarts it when it has ended.
    pub fn look_after(&mut self) {
        if let Some(child) = &mut self.child {
            match child.try_wait() {
                Ok(None) => return,
                ended => tracing::warn!(command = self.command, ?ended, "it has died and is started again"),
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
        command.arg(self.command).arg("--set-dir").arg(&self.set_dir);
        command.arg("--parent").arg(std::process::id().to_string()).args(&self.arguments);
        command.stdin(Stdio::null()).stdout(Stdio::null());
        match command.spawn() {
            Ok(child) => self.child = Some(child),
            Err(error) => {
                tracing::warn!(command = self.command, %error, "it cannot be started");
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

impl Drop for SideProcess {
    fn drop(&mut self) {
        self.end();
    }
}
