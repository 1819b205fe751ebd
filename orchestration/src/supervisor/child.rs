//! One replica of a stage as a child process. Starts it with its limits, reads its heartbeat, kills it, and plans its next start.

use super::hang::hangs;
use super::restarts::{AfterDeath, RestartPolicy};
use super::starvation::{RunState, StarvationWatch};
use super::supervision::ProcessLimits;
use crate::time_slice;
use flockslam_messages::Stage;
use flockslam_stage::heartbeat_file;
use flockslam_telemetry::{Beat, RestartReason, monotonic_ns, read_heartbeat};
use rustix::process::{
    Pid, PidfdFlags, Resource, Rlimit, Signal, getpriority_process, pidfd_open, prlimit, setpriority_process,
};
use rustix::thread::{CpuSet, sched_setaffinity};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// A process that lived for so long has worked, whether there was a scan for it or not.
const PROVEN: Duration = Duration::from_secs(10);
/// A fallback that ended is restarted after this.
const FALLBACK_PAUSE: Duration = Duration::from_millis(500);
/// What shall end comes before other processes by so many steps, where the system allows that: as many as what leads to a pose.
const ENDING_NICENESS: i32 = 10;

/// What a child is started with.
pub struct StartOrder<'a> {
    /// The executable.
    pub executable: &'a Path,
    /// Directory of the set.
    pub set_dir: &'a Path,
    /// What the process may use.
    pub limits: &'a ProcessLimits,
}

/// One stage's process, and its predecessors.
pub struct StageChild {
    /// Which stage.
    pub stage: Stage,
    /// Which replica of it, from 0.
    pub replica: u32,
    /// Processes so far; the last one is or was the present one.
    pub pids: Vec<u32>,
    /// How often it was replaced because it hung.
    pub hangs: u64,
    starvation: StarvationWatch,
    /// Why its process is killed, unless it ends by itself.
    killed_for: RestartReason,
    process: Option<(Child, OwnedFd)>,
    started: Instant,
    started_ns: u64,
    policy: RestartPolicy,
    due: Option<Instant>,
    given_up: Option<GivenUp>,
    /// How often it was given up since it worked last.
    times_given_up: u32,
    /// A process of the stage has worked at some time.
    has_worked: bool,
}

/// A stage that does not get up.
#[derive(Clone, Copy, Debug)]
struct GivenUp {
    retry_at: Instant,
    /// What runs now, or will, is the stage's fallback.
    is_fallback: bool,
}

impl StageChild {
    /// A stage that has not been started.
    pub fn new(stage: Stage, replica: u32) -> Self {
        Self {
            stage,
            replica,
            pids: Vec::new(),
            hangs: 0,
            starvation: StarvationWatch::default(),
            killed_for: RestartReason::default(),
            process: None,
            started: Instant::now(),
            started_ns: 0,
            policy: RestartPolicy::default(),
            due: None,
            given_up: None,
            times_given_up: 0,
            has_worked: false,
        }
    }

    /// Starts a process of the executable as the stage, or as its fallback.
    pub fn start(&mut self, order: &StartOrder<'_>) -> std::io::Result<()> {
        let mut command = Command::new(order.executable);
        command.args(["stage", self.stage.name(), "--set-dir"]).arg(order.set_dir);
        command.args(["--replica", &self.replica.to_string()]);
        command.arg("--parent").arg(std::process::id().to_string());
        if self.given_up.is_some_and(|given_up| given_up.is_fallback) {
            command.arg("--fallback");
        }
        let reads_stdin = self.stage == Stage::LidarIngest;
        command.stdin(if reads_stdin { Stdio::inherit() } else { Stdio::null() }).stdout(Stdio::null());
        let child = command.spawn()?;
        let pid = Pid::from_child(&child);
        let death = pidfd_open(pid, PidfdFlags::empty())?;
        // A process that has ended already needs none; its end is noticed by its descriptor.
        let _ = limit(pid, order.limits);
        self.pids.push(child.id());
        self.process = Some((child, death));
        (self.started, self.started_ns) = (Instant::now(), monotonic_ns());
        self.due = None;
        Ok(())
    }

    /// A descriptor that becomes readable when the process ends.
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

    /// Name of the stage's process in files and metrics.
    pub fn name(&self) -> String {
        format!("{}-{}", self.stage.name(), self.replica)
    }

    /// The last sign of life of the present (or last) process.
    pub fn beat(&self, status_dir: &Path) -> Option<Beat> {
        let beat = read_heartbeat(&self.heartbeat(status_dir)).ok()??;
        (Some(&beat.pid) == self.pids.last()).then_some(beat)
    }

    fn heartbeat(&self, status_dir: &Path) -> PathBuf {
        heartbeat_file(status_dir, &self.name())
    }

    /// Plans the start that follows the death of the process; false when the stage is given up.
    pub fn plan_restart(&mut self, status_dir: &Path) -> bool {
        if let Some(given_up) = &self.given_up {
            let pause = if given_up.is_fallback { FALLBACK_PAUSE } else { Duration::ZERO };
            self.due = Some(Instant::now() + pause);
            return given_up.is_fallback;
        }
        let worked = self.beat(status_dir).is_some_and(|beat| beat.works);
        self.has_worked |= worked;
        let after = self.policy.died(worked || self.started.elapsed() > PROVEN);
        if let AfterDeath::Restart(wait) = after {
            self.due = Some(Instant::now() + wait);
        }
        after != AfterDeath::GiveUp
    }

    /// The stage does not get up: it is tried again after `retry`, and until then something stands in for it, when there is
    /// something.
    pub fn give_up(&mut self, retry: Duration) {
        let retry_at = Instant::now() + retry;
        let is_fallback = self.stage == Stage::ScanMatcher;
        self.given_up = Some(GivenUp { retry_at, is_fallback });
        self.times_given_up += 1;
        self.due = Some(if is_fallback { Instant::now() } else { retry_at });
    }

    /// Whether there is hope for a stage that does not get up: it has worked before, and was not given up too often since.
    pub fn may_get_up(&self, retries_max: u32) -> bool {
        self.has_worked && self.times_given_up < retries_max
    }

    /// Starts in a row that ended before the stage had worked.
    pub fn failed_starts(&self) -> u32 {
        self.policy.failed_starts()
    }

    /// Ends the time of a fallback that is over.
    pub fn retry_when_due(&mut self) {
        let Some(given_up) = &mut self.given_up else { return };
        if given_up.is_fallback && given_up.retry_at <= Instant::now() {
            given_up.is_fallback = false;
            self.due = Some(Instant::now());
            self.signal(Signal::KILL);
        }
    }

    /// Takes note that the present process works; true when the stage had been given up.
    pub fn note_work(&mut self, status_dir: &Path) -> bool {
        if self.given_up.is_some_and(|given_up| given_up.is_fallback) || !self.is_running() {
            return false;
        }
        let works = self.beat(status_dir).is_some_and(|beat| beat.works);
        if works {
            self.policy.works();
            (self.has_worked, self.times_given_up) = (true, 0);
        }
        works && self.given_up.take().is_some()
    }

    /// Whether the stage does not get up and is done without.
    pub fn is_given_up(&self) -> bool {
        self.given_up.is_some()
    }

    /// Kills the process when it has been silent for too long though it could run; true when it has.
    pub fn kill_if_it_hangs(&mut self, status_dir: &Path, now_ns: u64, deadline: Duration) -> bool {
        if !self.is_running() || !hangs(self.beat(status_dir), self.started_ns, now_ns, deadline) {
            self.starvation.reset();
            return false;
        }
        let state = self.pids.last().and_then(|pid| RunState::of(*pid));
        if self.starvation.starves(state, now_ns, deadline) {
            return false;
        }
        self.starvation.reset();
        self.hangs += 1;
        self.killed_for = RestartReason::Hung;
        self.signal(Signal::KILL);
        true
    }

    /// Kills the process by order, to be started again.
    pub fn replace(&mut self) {
        self.killed_for = RestartReason::Ordered;
        self.signal(Signal::KILL);
    }

    /// Why the process that comes next is needed, once.
    pub fn take_restart_reason(&mut self) -> RestartReason {
        std::mem::take(&mut self.killed_for)
    }

    /// Whether a planned start is due.
    pub fn is_due(&self) -> bool {
        self.process.is_none() && self.due.is_some_and(|due| due <= Instant::now())
    }

    /// Whether its process lives.
    pub fn is_running(&self) -> bool {
        self.process.is_some()
    }

    /// Lets it end, if it lives: by SIGTERM or SIGKILL.
    pub fn signal(&self, signal: Signal) {
        if let Some((child, _)) = &self.process {
            let pid = Pid::from_child(child);
            let _ = rustix::process::kill_process(pid, signal);
            hurry(pid);
        }
    }

    /// Kills the process and waits for its end.
    pub fn end(&mut self) {
        if let Some((child, _)) = &mut self.process {
            let _ = child.kill();
            hurry(Pid::from_child(child));
            let _ = child.wait();
        }
        (self.process, self.due) = (None, None);
    }

    /// How often it was started again.
    pub fn restarts(&self) -> u64 {
        self.pids.len().saturating_sub(1) as u64
    }
}

/// Lets a process that shall end yield to nobody any more. Also to give its memory back it needs a processor, which a busy machine gives it
/// seconds later while it yields.
fn hurry(pid: Pid) {
    let Ok(own) = getpriority_process(None) else { return };
    let threads = std::fs::read_dir(format!("/proc/{}/task", pid.as_raw_pid()));
    let id =
        |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().parse().ok().and_then(Pid::from_raw);
    for thread in threads.into_iter().flatten().flatten().filter_map(id) {
        let priority = |niceness| setpriority_process(Some(thread), niceness);
        // Where that is not allowed, it ends when the machine lets it.
        let _ = priority(own - ENDING_NICENESS).or_else(|_| priority(own));
    }
}

fn limit(pid: Pid, limits: &ProcessLimits) -> rustix::io::Result<()> {
    match limits.nice {
        Some(nice @ 1..) => setpriority_process(Some(pid), getpriority_process(None)? + nice)?,
        // Where that is not allowed, the stage runs like any process.
        Some(nice @ ..=-1) => {
            let _ = setpriority_process(Some(pid), getpriority_process(None)? + nice);
            let _ = time_slice::set(Some(pid), time_slice::SHORT);
        }
        Some(0) | None => {}
    }
    if let Some(bytes) = limits.memory_max_bytes {
        // Private writable memory: memory shared with the set is not counted.
        prlimit(Some(pid), Resource::Data, Rlimit { current: Some(bytes), maximum: Some(bytes) })?;
    }
    if !limits.cpus.is_empty() {
        let mut set = CpuSet::new();
        limits.cpus.iter().filter(|cpu| **cpu < CpuSet::MAX_CPU).for_each(|cpu| set.set(*cpu));
        sched_setaffinity(Some(pid), &set)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shall_end_yields_to_nobody_where_the_system_allows_that() {
        let mut child = Command::new("sleep").arg("1000").spawn().unwrap();
        let pid = Pid::from_child(&child);
        let own = getpriority_process(None).unwrap();
        setpriority_process(Some(pid), own + 15).unwrap();
        hurry(pid);
        let found = getpriority_process(Some(pid)).unwrap();
        let is_allowed = setpriority_process(Some(pid), own).is_ok();
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(is_allowed, found <= own, "{found} beside {own}");
    }
}
