//! What the stage and the thread of the flock hand to each other.

use flockslam_evidence::Submap;
use flockslam_flock::Findings;
use flockslam_geometry::Pose;
use flockslam_messages::{FlockFrame, FlockRobots, PoseEstimate};
use flockslam_results::SubmapStore;
use std::ops::Range;
use std::sync::mpsc::Sender;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What the stage hands over.
pub enum Task {
    /// What the robot has found out.
    Findings(Findings),
    /// A closed submap.
    Submap(Box<Submap>),
    /// Stored submaps whose stale cells are to be published.
    Clearances(SubmapStore, Range<u32>),
    /// Where submaps lie in the robot's own map: number and `map_from_odom`, in order.
    SubmapPoses(Vec<(u32, Pose)>),
    /// The source has ended: to be answered when the robot may leave the flock.
    Finish(Sender<()>),
}

/// What the stage and the thread look up of each other: the newest of each.
#[derive(Default)]
pub struct Shared {
    /// Pose of the robot's map in that of the flock.
    pub frame: Mutex<Option<FlockFrame>>,
    /// Where the others are.
    pub robots: Mutex<FlockRobots>,
    /// Where this robot is.
    pub pose: Mutex<Option<PoseEstimate>>,
}

/// The value that a lock protects, also after a panic of its holder: each of these values is replaced as a whole.
pub fn locked<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
