//! The grid as its readers hold it: reads tiles and commits from the bus, gives one whole generation.

use crate::{StageContext, StageError};
use flockslam_bus::{Notifier, Publisher, Sample, Subscriber, TileHandle};
use flockslam_evidence::TileGrid;
use flockslam_messages::{Commit, CommitName, Control, ControlKind, Stage, TileMessage};

/// The active grid as a reader holds it: the newest sample of every tile, read in place in the mapper's memory.
/// Generations switch at commits and at nothing else.
pub struct GridReader {
    tiles: Subscriber<TileMessage>,
    commits: Subscriber<Commit>,
    control: Publisher<Control>,
    mapper: Notifier,
    grid: TileGrid<TileHandle>,
    waiting: Vec<Sample<TileMessage>>,
    later: Vec<Sample<TileMessage>>,
    committed: Option<Commit>,
    first: CommitName,
}

impl GridReader {
    /// Opens the grid of the set; cells have this side.
    ///
    /// # Errors
    /// When the topics do not exist.
    pub fn open(context: &StageContext, cell_size_m: f64) -> Result<Self, StageError> {
        Ok(Self {
            tiles: context.bus.subscriber()?,
            commits: context.bus.subscriber()?,
            control: context.bus.publisher()?,
            mapper: context.bus.notifier(Stage::Mapper.name())?,
            grid: TileGrid::new(cell_size_m),
            waiting: Vec::with_capacity(1024),
            later: Vec::new(),
            committed: None,
            first: CommitName::default(),
        })
    }

    /// Asks the mapper for all live tiles: after a restart it sends only changed ones by itself.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn request_tiles(&self) -> Result<(), StageError> {
        self.control.send(&Control { kind: ControlKind::TilesWanted as u32, run: 0, value: 0 })?;
        self.mapper.notify();
        Ok(())
    }

    /// Takes in tiles and commits that have arrived; returns the newest commit when there was one.
    ///
    /// # Errors
    /// When the bus fails.
    pub fn drain(&mut self) -> Result<Option<Commit>, StageError> {
        let mut newest = None;
        // Tiles are sent before their commit, so all tiles of a commit that is seen here have arrived below.
        while let Some(commit) = self.commits.receive()? {
            newest = Some(*commit);
            if self.first == CommitName::default() {
                self.first = commit.name;
            }
        }
        while let Some(tile) = self.tiles.receive()? {
            self.waiting.push(tile);
        }
        if let Some(commit) = newest {
            self.switch_to(&commit)?;
        }
        Ok(newest)
    }

    fn switch_to(&mut self, commit: &Commit) -> Result<(), StageError> {
        for tile in self.waiting.drain(..) {
            let key = tile.key;
            if tile.generation > commit.generation {
                self.later.push(tile);
            } else if tile.retired == 1 {
                self.grid.remove(key);
            } else if let Err(far) = self.grid.set(key, TileHandle::new(tile)) {
                tracing::warn!(%far, "a tile is out of reach");
            }
        }
        std::mem::swap(&mut self.waiting, &mut self.later);
        self.committed = Some(*commit);
        Ok(())
    }

    /// The first commit that has arrived.
    pub fn first_committed(&self) -> CommitName {
        self.first
    }

    /// The grid of the last commit.
    pub fn grid(&self) -> &TileGrid<TileHandle> {
        &self.grid
    }

    /// The last commit.
    pub fn committed(&self) -> Option<&Commit> {
        self.committed.as_ref()
    }
}
