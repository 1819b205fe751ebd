//! Overload: a stage ten or a hundred times slower than it should be, and somebody else's work on all processors. The newest scans get their
//! poses, what is left out is counted, memory stays what was laid out, and nothing that was accepted is lost.

mod support;

use flockslam::store::SavedMap;
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use flockslam_telemetry::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::Duration;
use support::faults::Evidence;
use support::{Drive, LiveSet, PoseWatch, of, wait_for};

const DRIVE: Drive = Drive { scan_rate_hz: 40.0, duration_s: 30.0, rate: 1.0 };
/// A slowed process has this much time …
const TURN: Duration = Duration::from_millis(2);
/// A queue of scans at 40 Hz that has not been shed would be older than this.
const NEWEST_WITHIN_S: f64 = 1.0;

/// Slow is not hanging: a process with a hundredth of a busy processor may be silent for longer than these usually may.
const SLOWED: [Stage; 5] =
    [Stage::LidarIngest, Stage::CorrelationFilter, Stage::ScanMatcher, Stage::Mapper, Stage::DynamicCleaner];

/// Something that goes on until it is dropped.
struct Nuisance {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Nuisance {
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

impl Drop for Nuisance {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| thread.join().unwrap());
    }
}

/// Lets something go on for 200 scans, and looks at the set during and after it.
fn overload(what: &str, begin: impl FnOnce(&mut LiveSet) -> Nuisance) {
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    let patient = SLOWED.map(|stage| format!("stages.{}.deadline_ms = 30000\n", stage.name())).concat();
    let mut set = LiveSet::start("overload", directory.path(), DRIVE, &format!("map = {map:?}\n{patient}"));
    let before = set.wait_until_handled(Stage::Mapper, 2);
    let poses = PoseWatch::start(&set.runtime_dir());
    let occupied_bytes = |set: &LiveSet| RuntimeDir::open(&set.runtime_dir()).unwrap().occupied_bytes();
    let memory_before = occupied_bytes(&set);
    let nuisance = begin(&mut set);
    let sent = of(&before, Stage::LidarIngest).handled + 200;
    set.wait_until_handled(Stage::LidarIngest, sent);
    let newest_s = wait_for("a pose of one of the newest scans", || {
        let newest = poses.seen().last().copied()?;
        let age_s = (monotonic_ns() - newest.pose.times.monotonic_ns) as f64 * 1e-9;
        (age_s < NEWEST_WITHIN_S).then_some(age_s)
    });
    drop(nuisance);
    let grown = occupied_bytes(&set).saturating_sub(memory_before);
    let after = set.wait_until("all stages to run", |status| status.stages.iter().all(|s| s.pid.is_some()));
    println!("{what}: newest pose {newest_s:.3} s old, {grown} bytes more in shared memory");
    for (before, after) in before.stages.iter().zip(&after.stages) {
        assert_eq!((before.pid, after.hangs), (after.pid, 0), "{} was replaced", after.stage);
    }
    // The map grows, queues do not: a window of scans, and tiles of what was driven through.
    assert!(grown < 64 << 20, "{grown} bytes");
    let outputs = set.finish();
    let report = &outputs.report;
    println!("dropped: {:?}", report.dropped);
    let left_out: u64 = report.dropped.values().sum();
    assert_eq!(report.kept + left_out, report.scans, "every scan is accounted for");
    let evidence = Evidence::of(&SavedMap::at(&map));
    assert_eq!(evidence.lost(), 0);
    assert!(evidence.inserted <= evidence.accepted());
}

#[test]
fn a_matcher_a_hundred_times_slower() {
    overload("slow matcher", |set| Nuisance::slow(set.pid(Stage::ScanMatcher), 100));
}

#[test]
fn a_mapper_ten_times_slower() {
    overload("slow mapper", |set| Nuisance::slow(set.pid(Stage::Mapper), 10));
}

#[test]
fn processors_that_are_busy_with_something_else() {
    overload("busy processors", |_| Nuisance::hog());
}
