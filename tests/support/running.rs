//! A run of `flockslam map` or `demo` that a test watches from outside while it goes on.

use super::{Outputs, assert_nothing_left, flockslam, robot, wait_for};
use flockslam_messages::Stage;
use flockslam_stage::{ProcessReport, heartbeat_file, metrics_socket, read_reports};
use flockslam_telemetry::{read_heartbeat, scrape};
use rustix::io::Errno;
use rustix::process::{Pid, Signal, kill_process};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::Duration;

/// A process set that a test watches from outside.
pub struct RunningSet {
    child: Child,
    robot: String,
    out: PathBuf,
    /// The other end of the set's standard input, when that is a pipe.
    pub stdin: Option<ChildStdin>,
}

impl RunningSet {
    /// Starts the executable; its outputs go to `out`.
    pub fn start(test: &str, out: &Path, args: &[String]) -> Self {
        Self::start_with(test, out, args, |command| {
            command.stdin(Stdio::null());
        })
    }

    /// As [`RunningSet::start`], with a pipe on its standard input.
    pub fn start_with_pipe(test: &str, out: &Path, args: &[String]) -> Self {
        Self::start_with(test, out, args, |command| {
            command.stdin(Stdio::piped());
        })
    }

    /// As [`RunningSet::start`], with more to arrange.
    pub fn start_with(test: &str, out: &Path, args: &[String], arrange: impl FnOnce(&mut Command)) -> Self {
        let robot = robot(test);
        let mut command = flockslam();
        command.args(args).args(["--robot", &robot, "--out"]).arg(out);
        command.stdout(Stdio::null()).stderr(Stdio::null());
        arrange(&mut command);
        let mut child = command.spawn().unwrap();
        let stdin = child.stdin.take();
        Self { child, robot, out: out.to_owned(), stdin }
    }

    /// Where the stages leave signs of life, reports and sockets.
    pub fn status_dir(&self) -> PathBuf {
        Path::new("/dev/shm").join(format!("flockslam-{}", self.robot)).join("status")
    }

    /// The name of the set.
    pub fn robot(&self) -> &str {
        &self.robot
    }

    /// The supervisor's process.
    pub fn supervisor_pid(&self) -> u32 {
        self.child.id()
    }

    /// The process that is a stage now, once it has given a sign of life.
    pub fn pid(&self, stage: Stage) -> u32 {
        let file = heartbeat_file(&self.status_dir(), &format!("{}-0", stage.name()));
        wait_for(&format!("a heartbeat of {}", stage.name()), || Some(read_heartbeat(&file).ok()??.pid))
    }

    /// Sends a signal to a stage.
    pub fn signal(&self, stage: Stage, signal: Signal) {
        send(self.pid(stage), signal);
    }

    /// What a stage answers on its socket; `None` when it does not answer.
    pub fn metrics(&self, stage: Stage) -> Option<String> {
        let socket = metrics_socket(&self.status_dir(), &format!("{}-0", stage.name()));
        scrape(&socket, Duration::from_millis(500)).ok()
    }

    /// Scans that the present process of a stage has handled; `None` when it does not answer.
    pub fn handled(&self, stage: Stage) -> Option<u64> {
        let page = self.metrics(stage)?;
        let line = page.lines().find(|line| line.starts_with("flockslam_scans_handled_total{"))?;
        line.rsplit(' ').next()?.parse().ok()
    }

    /// Waits until a stage has handled so many scans, and says how many.
    pub fn wait_until_handled(&mut self, stage: Stage, scans: u64) -> u64 {
        let what = format!("{scans} scans of {}", stage.name());
        wait_for(&what, || {
            assert!(self.child.try_wait().unwrap().is_none(), "{what}: the run has ended");
            self.handled(stage).filter(|handled| *handled >= scans)
        })
    }

    /// The report of a stage's present process, once it has written one that passes.
    pub fn report_with(&self, stage: Stage, passes: impl Fn(&ProcessReport) -> bool) -> ProcessReport {
        wait_for(&format!("a report of {}", stage.name()), || {
            read_reports(&self.status_dir(), stage.name()).pop().filter(&passes)
        })
    }

    /// Waits for the end of the run; its exit code.
    pub fn wait(&mut self) -> Option<i32> {
        let status = wait_for("the end of the run", || self.child.try_wait().unwrap());
        assert_nothing_left(&self.robot);
        status.code()
    }

    /// Waits for an end in good order and reads the outputs.
    pub fn finish(mut self) -> Outputs {
        assert_eq!(self.wait(), Some(0));
        Outputs::read(&self.out)
    }
}

impl Drop for RunningSet {
    fn drop(&mut self) {
        // A failed test leaves no set behind: stages die with their supervisor.
        if matches!(self.child.try_wait(), Ok(None)) {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// Sends a signal to a process.
pub fn send(pid: u32, signal: Signal) {
    assert!(try_send(pid, signal), "there is no process {pid}");
}

/// As [`send`]; whether there was such a process.
pub fn try_send(pid: u32, signal: Signal) -> bool {
    match kill_process(Pid::from_raw(pid as i32).unwrap(), signal) {
        Err(Errno::SRCH) => false,
        result => {
            result.unwrap();
            true
        }
    }
}
