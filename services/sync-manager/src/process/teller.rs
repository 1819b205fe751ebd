use crate::flock::Flock;
use crate::{Settings, Solution, SyncManager};
use flockslam_evidence::Submap;
use flockslam_records::{Clearance, Content, Limits, RobotKey};
use flockslam_stage::flock_files::{NamedPose, OWN_NODES, RecordLog, write_named};
use flockslam_stage::{StageError, SubmapStore};
use std::path::Path;

/// Epoch of a log that begins with a set of its own.
pub const FIRST_EPOCH: u64 = 1;

/// Says to the flock what this robot finds out, and keeps it in a file before anybody else hears of it.
pub struct Teller {
    flock: Flock,
    log: RecordLog,
    /// By submap: which of its cells the flock has been told are stale.
    cleared: Vec<Vec<(flockslam_evidence::TileKey, Box<[u64; flockslam_evidence::TILE_SIDE]>)>>,
}

impl Teller {
    /// The teller of the robot that settings name; `None` when they name none.
    ///
    /// # Errors
    /// When the name is not one of a robot, or the disk refuses.
    pub fn open(settings: &Settings, directory: &Path) -> Result<Option<Self>, StageError> {
        let name = &settings.flock.name;
        if name.is_empty() {
            return Ok(None);
        }
        let key = RobotKey::of_replay(name)
            .map_err(|e| StageError::Source(format!("sync_manager.flock.name: {e}")))?;
        let flock = Flock::new(key, FIRST_EPOCH, settings.clone(), Limits::default());
        Ok(Some(Self { flock, log: RecordLog::create(directory)?, cleared: Vec::new() }))
    }

    /// Says what is new, and what the submap is that was just closed.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn tell(&mut self, logic: &mut SyncManager, submap: Option<&Submap>) -> Result<(), StageError> {
        let mut said = self.flock.say_news(&logic.take_news()).map_err(unsaid)?;
        if let Some(submap) = submap {
            said.push(self.flock.say_submap(submap).map_err(unsaid)?);
        }
        said.iter().try_for_each(|record| self.log.append(record))
    }

    /// Says at the end what is left: stale cells of all submaps.
    ///
    /// # Errors
    /// When the store or the disk fails.
    pub fn finish(
        &mut self,
        logic: &mut SyncManager,
        solution: &Solution,
        store: &SubmapStore,
        directory: &Path,
    ) -> Result<(), StageError> {
        self.tell(logic, None)?;
        for number in 0..store.count() {
            self.tell_clearances(&store.load(number)?)?;
        }
        let row = |(sequence, pose): &(u64, _)| NamedPose { sequence: *sequence, stamp_ns: 0, pose: *pose };
        write_named(directory, OWN_NODES, &solution.anchors.iter().map(row).collect::<Vec<_>>())
    }

    fn tell_clearances(&mut self, submap: &Submap) -> Result<(), StageError> {
        let told = submap.number as usize;
        if self.cleared.len() <= told {
            self.cleared.resize_with(told + 1, Vec::new);
        }
        for tile in submap.tiles.iter().filter(|tile| tile.has_cleared()) {
            let rows = Box::new(tile.cleared);
            if self.cleared[told].iter().any(|(key, before)| *key == tile.key && *before == rows) {
                continue;
            }
            let clearance = Clearance {
                robot: self.flock.robot().clone(),
                epoch: FIRST_EPOCH,
                submap: submap.number,
                tile: tile.key,
                rows: rows.clone(),
            };
            let record = self.flock.say(&Content::Clearance(clearance)).map_err(unsaid)?;
            self.log.append(&record)?;
            self.cleared[told].retain(|(key, _)| *key != tile.key);
            self.cleared[told].push((tile.key, rows));
        }
        Ok(())
    }

    /// Goes on in another directory.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn move_to(&mut self, directory: &Path) -> Result<(), StageError> {
        self.log.move_to(directory)
    }
}

fn unsaid(error: flockslam_records::RecordError) -> StageError {
    StageError::file("a record for the flock", error)
}
