//! What the mapper publishes: tiles, commits and closed submaps.

use crate::Mapper;
use flockslam_bus::{Notifier, Publisher, TilePublisher};
use flockslam_evidence::TileKey;
use flockslam_messages::{Commit, CommitName, Stage, SubmapClosed};
use flockslam_stage::{StageContext, StageError};
use flockslam_telemetry::failpoint;

/// Tiles, commits and closed submaps on the bus.
pub(super) struct Output {
    tiles: TilePublisher,
    commits: Publisher<Commit>,
    /// Name of the last commit.
    last_name: CommitName,
    /// Closed submaps that the process began with.
    pub resumed_submaps: u32,
    submaps: Publisher<SubmapClosed>,
    matcher: Notifier,
    sync_manager: Notifier,
    /// Tiles that could not be sent for want of memory: they go out with the next commit.
    pub unsent: Vec<TileKey>,
    cell_size_m: f64,
}

impl Output {
    pub fn open(context: &StageContext, cell_size_m: f64) -> Result<Self, StageError> {
        let bus = &context.bus;
        Ok(Self {
            tiles: TilePublisher::open(bus)?,
            commits: bus.publisher()?,
            last_name: CommitName { mapper: context.now_ns(), number: 0 },
            resumed_submaps: 0,
            submaps: bus.publisher()?,
            matcher: bus.notifier(Stage::ScanMatcher.name())?,
            sync_manager: bus.notifier(Stage::SyncManager.name())?,
            unsent: Vec::new(),
            cell_size_m,
        })
    }

    /// Sends the changed tiles of a generation.
    pub fn send_tiles(&mut self, logic: &Mapper, generation: u64) -> Result<(), StageError> {
        let cell_size_m = self.cell_size_m;
        let mut sent = 0;
        for key in &self.unsent {
            let outcome = self.tiles.send_with(*key, |message| {
                (message.generation, message.cell_size_m) = (generation, cell_size_m);
                logic.write_tile(*key, &mut message.tile);
            });
            if let Err(error) = outcome {
                tracing::warn!(%error, "tiles wait for memory");
                break;
            }
            sent += 1;
        }
        self.unsent.drain(..sent);
        Ok(())
    }

    /// Retires tiles that have left the window.
    pub fn retire(&mut self, keys: &[TileKey], generation: u64) -> Result<(), StageError> {
        let cell_size_m = self.cell_size_m;
        for key in keys {
            self.tiles.send_with(*key, |message| {
                (message.generation, message.cell_size_m) = (generation, cell_size_m);
                message.retired = 1;
            })?;
        }
        Ok(())
    }

    /// Makes the tiles that were sent valid, and names the commit.
    pub fn commit(&mut self, commit: &Commit) -> Result<(), StageError> {
        self.last_name.number += 1;
        let (name, resumed_submaps) = (self.last_name, self.resumed_submaps);
        self.commits.send(&Commit { name, resumed_submaps, ..*commit })?;
        self.matcher.notify();
        Ok(())
    }

    /// Publishes a submap that is stored.
    pub fn publish_submap(&self, notice: &SubmapClosed) -> Result<(), StageError> {
        if failpoint("lost-notice") && notice.number == 1 {
            return Ok(());
        }
        self.submaps.send(notice)?;
        self.sync_manager.notify();
        Ok(())
    }

    /// Connects to readers that have started.
    pub fn refresh(&self) {
        self.tiles.refresh();
        self.commits.refresh();
        self.submaps.refresh();
    }
}
