//! SIGKILL of the stages of a set that localizes: the map that it localizes in must stay the same to the byte.

use super::{Seeded, Trial};
use crate::support::{Drive, LiveSet, building, is_localized, of, run_well, send, truth_error_m};
use flockslam::supervisor::{SetStatus, StageState};
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A map is made of so many seconds of driving.
const MAPPED_S: u32 = 120;
/// A drive has so many seconds for each kill: far more than one takes on a busy machine.
const KILL_S: f64 = 4.0;

/// Kills the stages of a set that localizes in turn, so many kills in all. A recovery lasts until a scan that was taken after the kill shows that the
/// robot is localized. No scan enters a map, so that none can be lost from one.
pub fn kills_while_localized(runs: usize, seed: u64) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let known = directory.path().join("known");
    let mapped = run_well("known", &known, &building(MAPPED_S));
    let kept = files(&known);
    let mut trial = Trial { fault: "kill a stage that localizes".to_owned(), ..Trial::default() };
    let drive = Drive { scan_rate_hz: 10.0, duration_s: 60.0 + KILL_S * runs as f64, rate: 1.0 };
    let mut set = LiveSet::start("localized", directory.path(), drive, &format!("localize = {known:?}"));
    set.wait_until("the robot is localized", is_localized);
    let in_set = RuntimeDir::open(&set.runtime_dir()).unwrap().results().join("known.map");
    let bytes_in_set = fs::read(&in_set).unwrap();
    for run in 0..runs {
        let stage = Stage::ALL[run % Stage::ALL.len()];
        set.wait_until("all stages to run", |status| {
            status.stages.iter().all(|stage| stage.state == StageState::Running)
        });
        std::thread::sleep(Duration::from_millis(random.below(100)));
        let (pid, since) = (set.pid(stage), Instant::now());
        send(pid, Signal::KILL);
        set.wait_until("a successor", |status| of(status, stage).pid.is_some_and(|now| now != pid));
        let known_ns = stamp_ns(&set.status().unwrap());
        set.wait_until("the robot is localized after a kill", |status| {
            is_localized(status) && stamp_ns(status) > known_ns
        });
        trial.recoveries_ms.push(since.elapsed().as_secs_f64() * 1e3);
        trial.runs += 1;
        if fs::read(&in_set).unwrap() != bytes_in_set {
            trial.violations.push(format!("kill {run} changed the map in the set"));
        }
    }
    trial.error_m = Some((truth_error_m(&set.finish()), truth_error_m(&mapped)));
    if files(&known) != kept {
        trial.violations.push("the known map has changed".to_owned());
    }
    trial
}

/// Sensor stamp of the newest scan that the belief takes into account.
fn stamp_ns(status: &SetStatus) -> i64 {
    status.localisation.as_ref().map_or(i64::MIN, |localisation| localisation.stamp_ns)
}

/// All files of a map and what is in them.
fn files(directory: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let paths = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> =
        paths.filter(|path| path.is_file()).map(|path| (path.clone(), fs::read(&path).unwrap())).collect();
    files.sort();
    files
}
