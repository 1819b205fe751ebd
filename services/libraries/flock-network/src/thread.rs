//! The thread of the flock, and the channels between it and the stage, which never waits for it.

use super::flock_exchange::FlockExchange;
use super::metrics::FlockMetrics;
use super::proximity::proximity;
use super::record_publisher::RecordPublisher;
use super::thread_state::{Shared, Task, locked};
use crate::settings::FlockSettings;
use flockslam_evidence::Submap;
use flockslam_messages::{FlockFrame, FlockRobots, PoseEstimate};
use flockslam_stage::StageError;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

/// While the stage waits for the end, it gives a sign of life this often.
const LOOK: Duration = Duration::from_millis(50);
/// Niceness of the thread and of those of the network, which it starts: whatever others send, poses and maps go first.
const NICENESS: i32 = 19;

/// The stage's handle of the thread that exchanges records with other robots, searches for inter-robot closures, and computes the common
/// solution: all of it beside the stage's own work, which only hands over what the robot itself has found out.
pub struct FlockThread {
    // Without a limit: it holds what the robot finds out itself, a few times a minute, and none of it may be lost.
    tasks: Sender<Task>,
    published_submaps: BTreeSet<u32>,
    shared: Arc<Shared>,
}

impl FlockThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// When a socket cannot be made, or the system has no thread left.
    pub fn start(
        settings: &FlockSettings,
        publisher: RecordPublisher,
        status_dir: &Path,
        metrics: FlockMetrics,
    ) -> Result<Self, StageError> {
        let (tasks, received) = channel();
        let shared = Arc::new(Shared::default());
        let published_submaps = publisher.published_submaps().clone();
        let near = proximity(settings, status_dir)?;
        let mut exchange = FlockExchange::new(
            settings,
            publisher,
            near,
            status_dir.to_owned(),
            metrics,
            Arc::clone(&shared),
        );
        let run = move || {
            // Should it be refused, the whole process yields to the others anyway.
            let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICENESS);
            exchange.run(&received);
        };
        let started = thread::Builder::new().name("flock".to_owned()).spawn(run);
        started.map_err(|error| StageError::file("the thread of the flock", error))?;
        Ok(Self { tasks, published_submaps, shared })
    }

    /// Hands something over.
    pub fn give(&self, task: Task) {
        // The thread ends with the process alone.
        let _ = self.tasks.send(task);
    }

    /// Hands over a submap that was just closed, unless the flock knows it; `load` gives it.
    ///
    /// # Errors
    /// When it cannot be loaded.
    pub fn publish_submap(
        &mut self,
        number: u32,
        load: impl FnOnce() -> Result<Submap, StageError>,
    ) -> Result<(), StageError> {
        if self.published_submaps.insert(number) {
            self.give(Task::Submap(Box::new(load()?)));
        }
        Ok(())
    }

    /// `flock_from_map`, while the robot is part of the flock's map.
    pub fn frame(&self) -> Option<FlockFrame> {
        *locked(&self.shared.frame)
    }

    /// Where the others are in the robot's map.
    pub fn robots(&self) -> FlockRobots {
        *locked(&self.shared.robots)
    }

    /// Takes note of where the robot is.
    pub fn is_at(&self, pose: &PoseEstimate) {
        *locked(&self.shared.pose) = Some(*pose);
    }

    /// Waits until the flock knows everything and everything of the flock is known, or too long has passed, or `stops` says so, which
    /// is asked all the while.
    pub fn finish(&self, mut stops: impl FnMut() -> bool) {
        let (done, waits) = channel();
        self.give(Task::Finish(done));
        while !stops() {
            match waits.recv_timeout(LOOK) {
                Err(RecvTimeoutError::Timeout) => {}
                Ok(()) | Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }
}
