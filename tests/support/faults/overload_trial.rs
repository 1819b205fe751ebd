//! Too little processor time: one stage is slowed, or other threads take all processors.

use super::{Evidence, Trial};
use crate::support::{Drive, LiveSet, PoseWatch, of, wait_for};
use flockslam::store::SavedMap;
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use flockslam_telemetry::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::Duration;

const DRIVE: Drive = Drive { scan_rate_hz: 40.0, duration_s: 30.0, rate: 1.0 };
/// A slowed process has this much time …
const TURN: Duration = Duration::from_millis(2);
/// A queue of scans at 40 Hz that has not been shed would be older than this.
const NEWEST_WITHIN_S: f64 = 1.0;
/// The map grows, queues do not: a window of scans, and tiles of what was driven through, bytes.
const GROWTH_MAX: u64 = 64 << 20;

/// Slow is not hanging: a process with a hundredth of a busy processor may be silent for longer than these usually may.
const SLOWED: [Stage; 5] =
    [Stage::LidarIngest, Stage::CorrelationFilter, Stage::ScanMatcher, Stage::Mapper, Stage::DynamicCleaner];

/// What takes processor time away.
#[derive(Clone, Copy, Debug)]
pub enum Overload {
    /// A stage is so many times slower.
    Slow(Stage, u32),
    /// Somebody else works on all processors.
    Hog,
}

impl Overload {
    fn name(self) -> String {
        match self {
            Self::Slow(stage, times) => format!("{} {times} times slower", stage.name()),
            Self::Hog => "processors that are busy with something else".to_owned(),
        }
    }

    fn begin(self, set: &mut LiveSet) -> Load {
        match self {
            Self::Slow(stage, times) => Load::slow(set.pid(stage), times),
            Self::Hog => Load::hog(),
        }
    }
}

/// Something that goes on until it is dropped.
struct Load {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    fn start(threads: usize, act: impl Fn() + Clone + Send + 'static) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let begin = |_| {
            let (stopped, act) = (Arc::clone(&stop), act.clone());
            spawn(move || {
                while !stopped.load(Ordering::Relaxed) {
                    act();
                }
            })
        };
        let threads = (0..threads).map(begin).collect();
        Self { stop, threads }
    }

    /// … and then has to wait until the same has passed so many times.
    fn slow(pid: u32, times: u32) -> Self {
        // So slow that it was taken to hang, it may have been replaced.
        let send_if_there = move |signal| {
            let _ = kill_process(Pid::from_raw(pid as i32).unwrap(), signal);
        };
        Self::start(1, move || {
            send_if_there(Signal::STOP);
            sleep((times - 1) * TURN);
            send_if_there(Signal::CONT);
            sleep(TURN);
        })
    }

    /// Work on all processors.
    fn hog() -> Self {
        let processors = std::thread::available_parallelism().map_or(2, usize::from);
        Self::start(2 * processors, || {
            let sum = (0..1_000_000_u64).fold(0, |sum, i| std::hint::black_box(sum ^ i));
            std::hint::black_box(sum);
        })
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| thread.join().unwrap());
    }
}

/// Lets it go on for 200 scans, and checks the set during and after it. The recovery is the age of the newest pose meanwhile.
pub fn overload(kind: Overload) -> Trial {
    let mut trial = Trial { fault: kind.name(), runs: 1, ..Trial::default() };
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    let patient = SLOWED.map(|stage| format!("stages.{}.deadline_ms = 30000\n", stage.name())).concat();
    let mut set = LiveSet::start("overload", directory.path(), DRIVE, &format!("map = {map:?}\n{patient}"));
    let before = set.wait_until_handled(Stage::Mapper, 2);
    let poses = PoseWatch::start(&set.runtime_dir());
    let occupied_bytes = |set: &LiveSet| RuntimeDir::open(&set.runtime_dir()).unwrap().occupied_bytes();
    let memory_before = occupied_bytes(&set);
    let load = kind.begin(&mut set);
    let sent = of(&before, Stage::LidarIngest).handled + 200;
    set.wait_until_handled(Stage::LidarIngest, sent);
    let newest_s = wait_for("a pose of one of the newest scans", || {
        let newest = poses.last()?;
        let age_s = (monotonic_ns() - newest.pose.times.monotonic_ns) as f64 * 1e-9;
        (age_s < NEWEST_WITHIN_S).then_some(age_s)
    });
    trial.recoveries_ms.push(newest_s * 1e3);
    drop(load);
    let grown = occupied_bytes(&set).saturating_sub(memory_before);
    if grown > GROWTH_MAX {
        trial.violations.push(format!("{grown} bytes more in shared memory"));
    }
    let after = set.wait_until("all stages to run", |status| status.stages.iter().all(|s| s.pid.is_some()));
    for (before, after) in before.stages.iter().zip(&after.stages) {
        if (before.pid, after.hangs) != (after.pid, 0) {
            trial.violations.push(format!("{} was replaced", after.stage));
        }
    }
    let report = set.finish().report;
    println!("{}: {grown} bytes more in shared memory, dropped: {:?}", trial.fault, report.dropped);
    let left_out: u64 = report.dropped.values().sum();
    if report.kept + left_out != report.scans {
        trial.violations.push(format!("of {} scans {} are kept", report.scans, report.kept));
    }
    let evidence = Evidence::of(&SavedMap::at(&map));
    trial.lost = evidence.lost();
    if trial.lost > 0 || evidence.inserted > evidence.accepted() {
        trial.violations.push(format!("{} accepted, {} in the map", evidence.accepted(), evidence.inserted));
    }
    trial
}
