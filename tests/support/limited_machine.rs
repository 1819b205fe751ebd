//! Machines that are smaller than this one: control groups that limit processor and memory of a set, shared memory included.

use super::{Outputs, assert_nothing_left, flockslam, live_building, not_tested, robot, stderr};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// The period within which a share of processors may be used up, microseconds.
const PERIOD_US: f64 = 100_000.0;
const MOUNT: &str = "/sys/fs/cgroup";

/// What a machine has.
#[derive(Clone, Copy, Debug)]
pub struct Machine {
    /// Processors, or a part of one.
    pub processors: f64,
    pub memory_mib: u64,
}

/// A set that has driven on such a machine.
pub struct Limited {
    pub outputs: Outputs,
    /// Most memory that it had at once, with shared memory and files in memory, as far as the system says.
    pub peak_mib: Option<f64>,
    /// How long it was held up because its share was used up, as far as the system says.
    pub held_up: Option<Duration>,
}

/// The groups of a machine, removed in the end.
struct Groups {
    folders: Vec<PathBuf>,
}

impl Groups {
    /// Version 1 has a folder for each subject, version 2 one for all.
    fn make(machine: &Machine) -> Option<Self> {
        let name = format!("flockslam-{}", std::process::id());
        let (quota, bytes) = (machine.processors * PERIOD_US, machine.memory_mib << 20);
        let folder = |subject: &str| Path::new(MOUNT).join(subject).join(&name);
        let (settings, folders) = if Path::new(MOUNT).join("cgroup.controllers").exists() {
            let _ = fs::write(Path::new(MOUNT).join("cgroup.subtree_control"), "+cpu +memory");
            let all = folder("");
            let settings = vec![
                (all.join("cpu.max"), format!("{quota:.0} {PERIOD_US:.0}")),
                (all.join("memory.max"), bytes.to_string()),
            ];
            (settings, vec![all])
        } else {
            let (cpu, memory) = (folder("cpu"), folder("memory"));
            let settings = vec![
                (cpu.join("cpu.cfs_period_us"), format!("{PERIOD_US:.0}")),
                (cpu.join("cpu.cfs_quota_us"), format!("{quota:.0}")),
                (memory.join("memory.limit_in_bytes"), bytes.to_string()),
            ];
            (settings, vec![cpu, memory])
        };
        let groups = Self { folders };
        let made = groups.folders.iter().all(|folder| fs::create_dir(folder).is_ok())
            && settings.iter().all(|(file, value)| fs::write(file, value).is_ok());
        if !made {
            not_tested(&format!("{machine:?}"), "no control group may be made");
        }
        made.then_some(groups)
    }

    /// A program in these groups.
    fn command(&self, program: &Command) -> Command {
        let mut command = Command::new("sh");
        let enter: String = self
            .folders
            .iter()
            .map(|folder| format!("echo $$ >'{}/cgroup.procs'; ", folder.display()))
            .collect();
        command.args(["-ec", &format!("{enter} exec \"$0\" \"$@\"")]).arg(program.get_program());
        command
    }

    fn number(&self, file: &str, word: &str) -> Option<f64> {
        let text = self.folders.iter().find_map(|folder| fs::read_to_string(folder.join(file)).ok())?;
        text.lines().find_map(|line| line.strip_prefix(word)?.trim().parse().ok())
    }
}

impl Drop for Groups {
    fn drop(&mut self) {
        for folder in &self.folders {
            let _ = fs::remove_dir(folder);
        }
    }
}

/// A live drive through the simulated office, 360 beams ten times a second; `None`, and noted, where nothing can be limited.
pub fn office_on(machine: &Machine, duration_s: u32, out: &Path) -> Option<Limited> {
    let groups = Groups::make(machine)?;
    let robot = robot("limited");
    let mut command = groups.command(&flockslam());
    command.args(live_building(duration_s, 1)).args(["--robot", &robot, "--out"]).arg(out);
    let output = command.output().unwrap();
    assert_nothing_left(&robot);
    assert!(output.status.success(), "{}", stderr(&output));
    let peak = groups
        .number("memory.max_usage_in_bytes", "")
        .or_else(|| groups.number("memory.peak", ""))
        .map(|bytes| bytes / f64::from(1 << 20));
    let held_up = groups
        .number("cpu.stat", "throttled_time ")
        .map(|ns| Duration::from_nanos(ns as u64))
        .or_else(|| groups.number("cpu.stat", "throttled_usec ").map(|us| Duration::from_micros(us as u64)));
    Some(Limited { outputs: Outputs::read(out), peak_mib: peak, held_up })
}
