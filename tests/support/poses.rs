//! Poses of a running set, read from its journal with the time at which each was there.

use super::wait_for;
use flockslam_bus::RuntimeDir;
use flockslam_messages::{PoseEstimate, PoseFlags};
use flockslam_stage::JournalReader;
use flockslam_telemetry::monotonic_ns;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::{Duration, Instant};

/// A pose, and when it was there to be seen.
#[derive(Clone, Copy)]
pub struct SeenPose {
    pub pose: PoseEstimate,
    pub seen_ns: u64,
}

/// Follows the poses of a running set by its journal, where each is written just before it is published.
pub struct PoseWatch {
    seen: Arc<Mutex<Vec<SeenPose>>>,
    stop: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

const PAUSE: Duration = Duration::from_millis(1);

impl PoseWatch {
    /// Begins with the poses that follow now.
    pub fn start(runtime_dir: &Path) -> Self {
        let mut journal = JournalReader::open(&RuntimeDir::open(runtime_dir).unwrap().journal()).unwrap();
        while journal.read_next().unwrap().is_some() {}
        let (seen, stop) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let (to, stopped) = (Arc::clone(&seen), Arc::clone(&stop));
        let reader = spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                while let Ok(Some(record)) = journal.read_next() {
                    to.lock().unwrap().push(SeenPose { pose: record.pose, seen_ns: monotonic_ns() });
                }
                sleep(PAUSE);
            }
        });
        Self { seen, stop, reader: Some(reader) }
    }

    /// All poses so far.
    pub fn seen(&self) -> Vec<SeenPose> {
        self.seen.lock().unwrap().clone()
    }

    /// The newest pose.
    pub fn last(&self) -> Option<SeenPose> {
        self.seen.lock().unwrap().last().copied()
    }

    /// How many poses there are.
    pub fn count(&self) -> usize {
        self.seen.lock().unwrap().len()
    }

    /// How many scans have entered the map.
    pub fn inserted(&self) -> usize {
        self.seen.lock().unwrap().iter().filter(|seen| seen.pose.has(PoseFlags::INSERT)).count()
    }

    /// How long after `since` there was a pose of a scan that was taken after it, milliseconds.
    pub fn back_after_ms(&self, since: Instant) -> f64 {
        let since_ns = monotonic_ns() - since.elapsed().as_nanos() as u64;
        let seen = wait_for("a pose", || {
            self.seen().into_iter().find(|seen| seen.pose.times.monotonic_ns > since_ns)
        });
        (seen.seen_ns - since_ns) as f64 * 1e-6
    }
}

impl Drop for PoseWatch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(reader) = self.reader.take() {
            let _ = reader.join();
        }
    }
}
