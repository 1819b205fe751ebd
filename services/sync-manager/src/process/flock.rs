//! The robot's side of the flock: what it says is kept, and, when it is asked to, others hear of it over the network.

use crate::{Solution, SyncManager};
use flockslam_flock_network::{FlockMetrics, FlockSettings, FlockThread, RecordPublisher, Task};
use flockslam_geometry::Pose;
use flockslam_messages::{FlockFrame, FlockRobots, PoseEstimate};
use flockslam_results::SubmapStore;
use flockslam_results::flock_files::{NamedPose, OWN_NODES, OWN_SCANS, write_named};
use flockslam_stage::{StageContext, StageError};
use std::path::Path;

/// After each closed submap so many before it are looked at for stale cells: in older ones nothing is cleared while the robot drives.
const WATCHED: u32 = 8;

/// How a robot tells others what it finds out.
pub enum Voice {
    /// It is alone, or stands by.
    Silent,
    /// It keeps what it would say.
    Recording(Box<RecordPublisher>),
    /// It talks.
    Talking(FlockThread),
}

impl Voice {
    /// The voice of the process that acts; `directory` is where what it says is kept.
    ///
    /// # Errors
    /// When the robot's key cannot be had, or the system refuses.
    pub fn open(
        settings: &FlockSettings,
        directory: &Path,
        status_dir: &Path,
        metrics: FlockMetrics,
    ) -> Result<Self, StageError> {
        Ok(match RecordPublisher::open(settings, directory)? {
            None => Self::Silent,
            Some(publisher) if settings.enabled => {
                Self::Talking(FlockThread::start(settings, publisher, status_dir, metrics)?)
            }
            Some(publisher) => Self::Recording(Box::new(publisher)),
        })
    }

    /// Tells what is new after a closed submap of the store.
    ///
    /// # Errors
    /// When the store or the disk fails.
    pub fn tell(
        &mut self,
        logic: &mut SyncManager,
        number: u32,
        store: &SubmapStore,
    ) -> Result<(), StageError> {
        match self {
            Self::Silent => Ok(()),
            Self::Recording(publisher) => {
                publisher.tell(logic.take_news())?;
                if publisher.told_submaps().contains(&number) {
                    return Ok(());
                }
                publisher.tell_submap(&store.load(number)?)
            }
            Self::Talking(thread) => {
                thread.give(Task::News(logic.take_news()));
                thread.tell_submap(number, || Ok(store.load(number)?))?;
                thread.give(Task::Clearances(store.clone(), number.saturating_sub(WATCHED)..number));
                thread.give(Task::Layout(places(logic)));
                Ok(())
            }
        }
    }

    /// How the robot's map lies in that of the flock, while it is part of it.
    pub fn frame(&self) -> Option<FlockFrame> {
        match self {
            Self::Talking(thread) => thread.frame(),
            Self::Silent | Self::Recording(_) => None,
        }
    }

    /// Where the other robots are in the robot's map, as far as they are part of the same.
    pub fn robots(&self) -> FlockRobots {
        match self {
            Self::Talking(thread) => thread.robots(),
            Self::Silent | Self::Recording(_) => FlockRobots::default(),
        }
    }

    /// Takes note of where the robot is, for those who are near.
    pub fn is_at(&self, pose: &PoseEstimate) {
        if let Self::Talking(thread) = self {
            thread.is_at(pose);
        }
    }

    /// Tells what is left at the end – stale cells of all submaps – and leaves the robot's own trajectory beside its records. Then
    /// waits for the others.
    ///
    /// # Errors
    /// When the store or the disk fails.
    pub fn finish(
        &mut self,
        logic: &mut SyncManager,
        solution: &Solution,
        store: &SubmapStore,
        scans: &[NamedPose],
        context: &mut StageContext,
    ) -> Result<(), StageError> {
        match self {
            Self::Silent => return Ok(()),
            Self::Recording(publisher) => {
                publisher.tell(logic.take_news())?;
                (0..store.count()).try_for_each(|number| publisher.tell_clearances(&store.load(number)?))?;
            }
            Self::Talking(thread) => {
                thread.give(Task::News(logic.take_news()));
                thread.give(Task::Clearances(store.clone(), 0..store.count()));
                thread.give(Task::Layout(places(logic)));
            }
        }
        let row = |(sequence, pose): &(u64, _)| NamedPose { sequence: *sequence, stamp_ns: 0, pose: *pose };
        let nodes: Vec<_> = solution.anchors.iter().map(row).collect();
        write_named(&context.result_dir, OWN_NODES, &nodes)?;
        write_named(&context.result_dir, OWN_SCANS, scans)?;
        if let Self::Talking(thread) = self {
            thread.finish(|| {
                context.alive();
                context.stop.is_set()
            });
        }
        Ok(())
    }
}

/// Where submaps lie in the robot's own map.
fn places(logic: &SyncManager) -> Vec<(u32, Pose)> {
    logic.layout().iter().map(|placed| (placed.number, placed.map_from_odom)).collect()
}
