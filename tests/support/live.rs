//! A set that was started by `flockslam up`: orders, status, end, and a start after its supervisor was killed.

use super::{
    Outputs, assert_nothing_left, flockslam, processes_of, robot, send, stderr, wait_for, wait_for_every,
};
use flockslam::supervisor::{Reply, Request, SetStatus, StageStatus, ask};
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

/// The supervisor works for each answer.
const STATUS_EVERY: Duration = Duration::from_millis(20);

/// A process set started by `flockslam up`, in a directory of its own.
pub struct LiveSet {
    child: Child,
    robot: String,
    directory: PathBuf,
    arguments: Vec<String>,
    failpoints: String,
}

/// A simulated drive: scans a second, seconds, and simulated seconds a second.
#[derive(Clone, Copy)]
pub struct Drive {
    pub scan_rate_hz: f64,
    pub duration_s: f64,
    pub rate: f64,
}

impl Drive {
    /// The description of a set that drives it, with `more` lines of TOML at the front.
    pub fn description(&self, robot: &str, more: &str) -> String {
        let Self { scan_rate_hz, duration_s, rate } = self;
        format!(
            "robot = \"{robot}\"\n{more}\n\
             set = [\"page.enabled=false\", \"sync_manager.retire_covered_by=0\", \"simulation.duration_s={duration_s:?}\", \"simulation.scan_rate_hz={scan_rate_hz:?}\"]\n\
             [source]\nkind = \"simulation\"\nrate = {rate:?}\n"
        )
    }

    /// Scans that the robot takes on the way.
    pub fn scans(&self) -> usize {
        (self.scan_rate_hz * self.duration_s) as usize
    }
}

impl LiveSet {
    /// Starts a drive under a name of its own; the description and all that is written lie in `directory`.
    pub fn start(test: &str, directory: &Path, drive: Drive, more: &str) -> Self {
        let robot = robot(test);
        std::fs::write(directory.join("set.toml"), drive.description(&robot, more)).unwrap();
        Self::start_again(robot, directory, &[])
    }

    /// As [`LiveSet::start`], in a world that is a map of nav2's kind.
    pub fn start_in(world: &Path, test: &str, directory: &Path, drive: Drive, more: &str) -> Self {
        Self::start_in_with(world, test, directory, drive, more, &[])
    }

    /// The same with more arguments of the command.
    pub fn start_in_with(
        world: &Path,
        test: &str,
        directory: &Path,
        drive: Drive,
        more: &str,
        arguments: &[String],
    ) -> Self {
        let robot = robot(test);
        let description = format!("{}world = {world:?}\n", drive.description(&robot, more));
        std::fs::write(directory.join("set.toml"), description).unwrap();
        Self::start_again(robot, directory, arguments)
    }

    /// As [`LiveSet::start`], with protections taken away from it.
    pub fn start_with_failpoints(
        test: &str,
        directory: &Path,
        drive: Drive,
        more: &str,
        arguments: &[String],
        failpoints: &str,
    ) -> Self {
        let robot = robot(test);
        std::fs::write(directory.join("set.toml"), drive.description(&robot, more)).unwrap();
        Self::spawn(robot, directory, arguments, failpoints)
    }

    /// Starts the set that is described in `directory`.
    pub fn start_again(robot: String, directory: &Path, arguments: &[String]) -> Self {
        Self::spawn(robot, directory, arguments, "")
    }

    /// As [`LiveSet::start`], by a command that ends in running the executable with what is added to it.
    pub fn start_by(command: Command, test: &str, directory: &Path, drive: Drive, more: &str) -> Self {
        let robot = robot(test);
        std::fs::write(directory.join("set.toml"), drive.description(&robot, more)).unwrap();
        Self::start_described(command, robot, directory)
    }

    /// Starts the set that is described in `directory` by such a command.
    pub fn start_described(mut command: Command, robot: String, directory: &Path) -> Self {
        command.arg("up").arg(directory.join("set.toml")).arg("--out").arg(directory.join("out"));
        Self::of_command(command, robot, directory)
    }

    /// Starts a set by a command that is complete.
    pub fn of_command(mut command: Command, robot: String, directory: &Path) -> Self {
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        Self {
            child,
            robot,
            directory: directory.to_owned(),
            arguments: Vec::new(),
            failpoints: String::new(),
        }
    }

    fn spawn(robot: String, directory: &Path, arguments: &[String], failpoints: &str) -> Self {
        let mut command = flockslam();
        command.env("FLOCKSLAM_FAILPOINTS", failpoints);
        command.arg("up").arg(directory.join("set.toml")).arg("--out").arg(directory.join("out"));
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let child = command.spawn().unwrap();
        let (directory, failpoints) = (directory.to_owned(), failpoints.to_owned());
        Self { child, robot, directory, arguments: arguments.to_owned(), failpoints }
    }

    /// The name of the set.
    pub fn robot(&self) -> &str {
        &self.robot
    }

    /// Its directory in shared memory.
    pub fn runtime_dir(&self) -> PathBuf {
        RuntimeDir::path_of(&self.robot)
    }

    /// The supervisor's process.
    pub fn supervisor_pid(&self) -> u32 {
        self.child.id()
    }

    /// Asks the supervisor; `None` while nobody answers.
    pub fn ask(&self, request: &Request) -> Option<Reply> {
        ask(&self.runtime_dir().join("control"), request).ok()
    }

    /// How the set is; `None` while nobody answers.
    pub fn status(&self) -> Option<SetStatus> {
        match self.ask(&Request::Status)? {
            Reply::Status(status) => Some(*status),
            other => panic!("{other:?}"),
        }
    }

    /// Waits until the set is as asked for. A set that ends before it fails the test with what its stages last said.
    pub fn wait_until(&mut self, what: &str, is: impl Fn(&SetStatus) -> bool) -> SetStatus {
        let mut last_seen = String::new();
        wait_for_every(STATUS_EVERY, what, || {
            let ended = self.child.try_wait().unwrap();
            assert!(ended.is_none(), "{what}: the set has ended: {ended:?}; before: {last_seen}");
            let status = self.status()?;
            let of_stage = |stage: &StageStatus| {
                format!("{} {:?} {} handled {} hangs", stage.stage, stage.state, stage.handled, stage.hangs)
            };
            last_seen = status.stages.iter().map(of_stage).collect::<Vec<_>>().join(", ");
            is(&status).then_some(status)
        })
    }

    /// Waits until a stage has handled so many scans in its present process.
    pub fn wait_until_handled(&mut self, stage: Stage, scans: u64) -> SetStatus {
        let what = format!("{scans} scans of {}", stage.name());
        self.wait_until(&what, |status| of(status, stage).handled >= scans)
    }

    /// The process of a stage, once it is there.
    pub fn pid(&mut self, stage: Stage) -> u32 {
        let status = self.wait_until("a process", |status| of(status, stage).pid.is_some());
        of(&status, stage).pid.unwrap()
    }

    /// Kills the supervisor, waits until nothing of the set is alive, and starts it again.
    pub fn kill_and_start_again(mut self) -> Self {
        send(self.supervisor_pid(), Signal::KILL);
        self.wait_for_death();
        self.start_once_more()
    }

    /// Waits until nothing of a set whose supervisor was killed is alive.
    pub fn wait_for_death(&mut self) {
        self.child.wait().unwrap();
        wait_for("the death of all stages", || processes_of(&self.runtime_name()).is_empty().then_some(()));
    }

    /// Starts a set that is dead again.
    pub fn start_once_more(self) -> Self {
        let again = Self::spawn(self.robot.clone(), &self.directory, &self.arguments, &self.failpoints);
        // What is dropped here is dead already.
        std::mem::forget(self);
        again
    }

    /// What the command lines of its stages have in them.
    fn runtime_name(&self) -> String {
        self.runtime_dir().display().to_string()
    }

    /// Waits for the end; its exit code. Nothing is left.
    pub fn wait(&mut self) -> Option<i32> {
        let status = wait_for("the end of the set", || self.child.try_wait().unwrap());
        assert_nothing_left(&self.robot);
        status.code()
    }

    /// Waits for the end of its source and reads the outputs.
    pub fn finish(mut self) -> Outputs {
        assert_eq!(self.wait(), Some(0));
        Outputs::read(&self.directory.join("out"))
    }

    /// Runs another command of the executable on this set.
    pub fn command(&self, args: &[&str]) -> Output {
        flockslam().args(args).args(["--robot", &self.robot]).output().unwrap()
    }

    /// As [`LiveSet::command`], and it must succeed.
    pub fn command_well(&self, args: &[&str]) -> Output {
        let output = self.command(args);
        assert!(output.status.success(), "{args:?}: {}", stderr(&output));
        output
    }
}

/// Whether a set knows where in the map its robot is.
pub fn is_localized(status: &SetStatus) -> bool {
    status.localisation.as_ref().is_some_and(|localisation| localisation.knowledge == "localized")
}

/// What a status says of the first process of a stage.
pub fn of(status: &SetStatus, stage: Stage) -> &StageStatus {
    status.stages.iter().find(|found| found.stage == stage.name()).unwrap()
}

impl Drop for LiveSet {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            let _ = self.child.kill();
            let _ = self.child.wait();
            wait_for("the death of all stages", || {
                processes_of(&self.runtime_name()).is_empty().then_some(())
            });
            // The state of a killed set outlives it; that of a failed test is of no use.
            let _ = std::fs::remove_file(self.runtime_dir().join("kept"));
        }
    }
}
