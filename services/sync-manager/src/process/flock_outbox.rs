//! The robot's side of the flock: its records are kept on disk, and published over the network if this is configured.

use crate::{Solution, SyncManager};
use flockslam_flock_network::{FlockMetrics, FlockSettings, FlockThread, RecordPublisher, Task};
use flockslam_geometry::Pose;
use flockslam_messages::{FlockFrame, FlockRobots, PoseEstimate};
use flockslam_results::SubmapStore;
use flockslam_results::flock_files::{NamedPose, OWN_NODES, OWN_SCANS, write_named};
use flockslam_stage::{StageContext, StageError};
use std::path::Path;

/// After each closed submap so many before it are checked for stale cells: in older ones nothing is cleared while the robot drives.
const WATCHED: u32 = 8;

/// How a robot publishes its findings.
pub enum Outbox {
    /// The robot is alone, or this process is on standby.
    Silent,
    /// Records are kept on disk.
    Recording(Box<RecordPublisher>),
    /// Records are published over the network.
    Talking(FlockThread),
}

impl Outbox {
    /// The outbox of the active process; records are kept in `directory`.
    ///
    /// # Errors
    /// When the robot's key cannot be read or made, or the thread cannot be started.
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

    /// Publishes what is new after a closed submap of the store.
    ///
    /// # Errors
    /// When the store or the disk fails.
    pub fn publish(
        &mut self,
        logic: &mut SyncManager,
        number: u32,
        store: &SubmapStore,
    ) -> Result<(), StageError> {
        match self {
            Self::Silent => Ok(()),
            Self::Recording(publisher) => {
                publisher.publish(logic.take_unpublished())?;
                if publisher.published_submaps().contains(&number) {
                    return Ok(());
                }
                publisher.publish_submap(&store.load(number)?)
            }
            Self::Talking(thread) => {
                thread.give(Task::Findings(logic.take_unpublished()));
                thread.publish_submap(number, || Ok(store.load(number)?))?;
                thread.give(Task::Clearances(store.clone(), number.saturating_sub(WATCHED)..number));
                thread.give(Task::SubmapPoses(places(logic)));
                Ok(())
            }
        }
    }

    /// `flock_from_map`, while the robot is part of the flock's map.
    pub fn frame(&self) -> Option<FlockFrame> {
        match self {
            Self::Talking(thread) => thread.frame(),
            Self::Silent | Self::Recording(_) => None,
        }
    }

    /// Poses of the other robots in the robot's map, as far as they are part of the flock's map.
    pub fn robots(&self) -> FlockRobots {
        match self {
            Self::Talking(thread) => thread.robots(),
            Self::Silent | Self::Recording(_) => FlockRobots::default(),
        }
    }

    /// Publishes the robot's pose to near robots.
    pub fn is_at(&self, pose: &PoseEstimate) {
        if let Self::Talking(thread) = self {
            thread.is_at(pose);
        }
    }

    /// Publishes the rest at the end – stale cells of all submaps – and writes the robot's own trajectory beside its records. Then
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
                publisher.publish(logic.take_unpublished())?;
                (0..store.count())
                    .try_for_each(|number| publisher.publish_clearances(&store.load(number)?))?;
            }
            Self::Talking(thread) => {
                thread.give(Task::Findings(logic.take_unpublished()));
                thread.give(Task::Clearances(store.clone(), 0..store.count()));
                thread.give(Task::SubmapPoses(places(logic)));
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

/// Poses of the submaps in the robot's own map.
fn places(logic: &SyncManager) -> Vec<(u32, Pose)> {
    logic.submap_poses().iter().map(|placed| (placed.number, placed.map_from_odom)).collect()
}
