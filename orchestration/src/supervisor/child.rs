use flockslam_messages::Stage;
use rustix::process::{Pid, PidfdFlags, getpriority_process, pidfd_open, setpriority_process};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Deaths in a row, each soon after its start, after which a stage is given up.
const HASTY_DEATHS_MAX: u32 = 5;
/// A process that lived for less than this died soon after its start.
const HASTY: Duration = Duration::from_secs(1);
const BACK_OFF_FIRST: Duration = Duration::from_millis(100);
const BACK_OFF_MAX: Duration = Duration::from_secs(5);

/// One stage's process, and its predecessors.
pub struct StageChild {
    /// Which stage.
    pub stage: Stage,
    /// Which replica of it, from 0.
    pub replica: u32,
    /// Processes so far; the last one is or was the present one.
    pub pids: Vec<u32>,
    process: Option<(Child, OwnedFd)>,
    started: Instant,
    hasty_deaths: u32,
    due: Option<Instant>,
}

impl StageChild {
    /// A stage that has not been started.
    pub fn new(stage: Stage, replica: u32) -> Self {
        Self {
            stage,
            replica,
            pids: Vec::new(),
            process: None,
            started: Instant::now(),
            hasty_deaths: 0,
            due: None,
        }
    }

    /// Starts a process of this executable as the stage, so many steps of niceness behind this one.
    pub fn start(
        &mut self,
        executable: &Path,
        set_dir: &Path,
        reads_stdin: bool,
        niceness: i32,
    ) -> std::io::Result<()> {
        let mut command = Command::new(executable);
        command.args(["stage", self.stage.name(), "--set-dir"]).arg(set_dir);
        command.args(["--replica", &self.replica.to_string()]);
        command.arg("--parent").arg(std::process::id().to_string());
        command.stdin(if reads_stdin { Stdio::inherit() } else { Stdio::null() }).stdout(Stdio::null());
        let child = command.spawn()?;
        let pid = Pid::from_child(&child);
        let death = pidfd_open(pid, PidfdFlags::empty())?;
        if niceness > 0 {
            // A process that has ended already needs none; its end is noticed by its descriptor.
            let _ = setpriority_process(Some(pid), getpriority_process(None)? + niceness);
        }
        self.pids.push(child.id());
        self.process = Some((child, death));
        self.started = Instant::now();
        self.due = None;
        Ok(())
    }

    /// A descriptor that becomes readable when the process dies.
    pub fn death(&self) -> Option<&OwnedFd> {
        self.process.as_ref().map(|(_, death)| death)
    }

    /// How the process ended, once it has.
    pub fn reap(&mut self) -> Option<ExitStatus> {
        let (child, _) = self.process.as_mut()?;
        let status = child.try_wait().ok().flatten()?;
        self.process = None;
        Some(status)
    }

    /// Plans the next start: at once the first time, later and later when processes keep dying young. False when it is
    /// given up.
    pub fn plan_restart(&mut self) -> bool {
        let young = self.started.elapsed() < HASTY;
        self.hasty_deaths = if young { self.hasty_deaths + 1 } else { 0 };
        let wait = match self.hasty_deaths {
            0 | 1 => Duration::ZERO,
            deaths => (BACK_OFF_FIRST * 2_u32.saturating_pow(deaths - 2)).min(BACK_OFF_MAX),
        };
        self.due = Some(Instant::now() + wait);
        self.hasty_deaths < HASTY_DEATHS_MAX
    }

    /// Whether a planned start is due.
    pub fn is_due(&self) -> bool {
        self.process.is_none() && self.due.is_some_and(|due| due <= Instant::now())
    }

    /// Whether its process lives.
    pub fn is_running(&self) -> bool {
        self.process.is_some()
    }

    /// Sends a signal, if it lives.
    pub fn signal(&self, signal: rustix::process::Signal) {
        if let Some((child, _)) = &self.process {
            let _ = rustix::process::kill_process(Pid::from_child(child), signal);
        }
    }

    /// How often it was started again.
    pub fn restarts(&self) -> u64 {
        self.pids.len().saturating_sub(1) as u64
    }
}
