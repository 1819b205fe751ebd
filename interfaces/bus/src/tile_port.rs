use crate::Sample;
use flockslam_evidence::Tile;
use flockslam_messages::TileMessage;
use std::ops::Deref;

/// A tile held in the mapper's memory: the newest sample of it that a reader has.
pub struct TileHandle(Sample<TileMessage>);

impl TileHandle {
    /// Holds on to a received tile.
    pub fn new(sample: Sample<TileMessage>) -> Self {
        Self(sample)
    }

    /// The message around the tile.
    pub fn message(&self) -> &TileMessage {
        &self.0
    }
}

impl Deref for TileHandle {
    type Target = Tile;

    fn deref(&self) -> &Tile {
        &self.0.tile
    }
}
