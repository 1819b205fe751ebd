//! The map published by several processes, each with its share of the tiles.

use crate::TileShare;
use flockslam_bus::{Notifier, Publisher, Subscriber};
use flockslam_messages::{PartInserted, PoseEstimate, Stage};
use flockslam_stage::{StageContext, StageError};

/// State of the other mappers. Each mapper has the whole map and sends its share of the tiles. The first one publishes for
/// all: it commits a scan when every mapper has sent its tiles, and stores closed submaps.
pub(super) struct Parts {
    part: u32,
    parts: u32,
    publisher: Publisher<PartInserted>,
    others: Subscriber<PartInserted>,
    first: Notifier,
    /// By share: scans with a sequence below this are in it, and tiles that were sent for the last of them.
    inserted: Vec<(u64, u32)>,
    /// Shares all of whose tiles were sent once more since the last look.
    republished: u32,
}

impl Parts {
    pub fn open(context: &StageContext, parts: u32) -> Result<Self, StageError> {
        let bus = &context.bus;
        Ok(Self {
            part: context.replica,
            parts,
            publisher: bus.publisher()?,
            others: bus.subscriber()?,
            first: bus.notifier(Stage::Mapper.name())?,
            inserted: vec![(0, 0); parts as usize],
            republished: 0,
        })
    }

    /// The tiles that this process looks after.
    pub fn share(&self) -> TileShare {
        TileShare::new(self.part, self.parts)
    }

    /// Whether this process publishes for all.
    pub fn is_first(&self) -> bool {
        self.part == 0
    }

    /// Processes beside this one.
    pub fn others(&self) -> u32 {
        self.parts - 1
    }

    /// Tells the first mapper that tiles were sent: those that a scan has changed, or all.
    pub fn publish(&self, pose: &PoseEstimate, tiles: usize, all_tiles: bool) -> Result<(), StageError> {
        let (id, tiles) = (pose.id, tiles as u32);
        let message =
            PartInserted { id, tiles, part: self.part, parts: self.parts, all_tiles: all_tiles.into() };
        self.publisher.send(&message)?;
        self.first.notify();
        Ok(())
    }

    /// Reads the messages of the others.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while let Some(message) = self.others.receive()? {
            let of_share = self.inserted.get_mut(message.part as usize);
            let Some(inserted) = of_share.filter(|_| message.parts == self.parts) else { continue };
            self.republished += message.all_tiles;
            if message.id.sequence >= inserted.0 {
                *inserted = (message.id.sequence + 1, message.tiles);
            }
        }
        Ok(())
    }

    /// The number of tiles that the others have sent for a scan, once all of them have.
    pub fn have_inserted(&self, sequence: u64) -> Option<u32> {
        let others = &self.inserted[1..];
        let all = others.iter().all(|(next, _)| *next > sequence);
        all.then(|| others.iter().map(|(_, tiles)| tiles).sum())
    }

    /// How many others have sent all their tiles once more since the last call.
    pub fn take_republished(&mut self) -> u32 {
        std::mem::take(&mut self.republished)
    }
}
