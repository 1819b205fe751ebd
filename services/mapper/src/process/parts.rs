//! The map kept by several processes, each with its share of the tiles.

use crate::{Mapper, TileShare};
use flockslam_bus::{BellRinger, Publisher, Subscriber};
use flockslam_evidence::Submap;
use flockslam_messages::{PartInserted, PoseEstimate, Stage};
use flockslam_stage::{StageContext, StageError, SubmapStore};
use std::collections::VecDeque;

/// What one of several mappers knows of the others. The first speaks for all: it commits a scan when every one has sent its tiles,
/// and puts closed submaps together from the parts that the others store.
pub(super) struct Parts {
    part: u32,
    parts: u32,
    told: Publisher<PartInserted>,
    others: Subscriber<PartInserted>,
    first: BellRinger,
    /// By share: scans with a sequence below this are in it, and tiles that were sent for the last of them.
    inserted: Vec<(u64, u32)>,
    /// Shares all of whose tiles were sent once more since the last look.
    republished: u32,
    /// Closed submaps of which parts are missing, oldest first.
    unmerged: VecDeque<Submap>,
}

impl Parts {
    pub fn open(context: &StageContext, parts: u32) -> Result<Self, StageError> {
        let bus = &context.bus;
        Ok(Self {
            part: context.replica,
            parts,
            told: bus.publisher()?,
            others: bus.subscriber()?,
            first: bus.ringer(Stage::Mapper.name())?,
            inserted: vec![(0, 0); parts as usize],
            republished: 0,
            unmerged: VecDeque::new(),
        })
    }

    /// The tiles that this process looks after.
    pub fn share(&self) -> TileShare {
        TileShare::new(self.part, self.parts)
    }

    /// Whether this process speaks for all.
    pub fn is_first(&self) -> bool {
        self.part == 0
    }

    /// Processes beside this one.
    pub fn others(&self) -> u32 {
        self.parts - 1
    }

    /// Tells the first mapper that tiles are out: those that a scan has changed, or all.
    pub fn tell(&self, pose: &PoseEstimate, tiles: usize, all_tiles: bool) -> Result<(), StageError> {
        let (id, tiles) = (pose.id, tiles as u32);
        let told =
            PartInserted { id, tiles, part: self.part, parts: self.parts, all_tiles: all_tiles.into() };
        self.told.send(&told)?;
        self.first.ring();
        Ok(())
    }

    /// Lets the first mapper look what there is.
    pub fn ring_first(&self) {
        if !self.is_first() {
            self.first.ring();
        }
    }

    /// Hears of the others.
    pub fn drain(&mut self) -> Result<(), StageError> {
        while let Some(told) = self.others.receive()? {
            let of_share = self.inserted.get_mut(told.part as usize);
            let Some(inserted) = of_share.filter(|_| told.parts == self.parts) else { continue };
            self.republished += told.all_tiles;
            if told.id.sequence >= inserted.0 {
                *inserted = (told.id.sequence + 1, told.tiles);
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

    /// Takes in a submap that was closed here.
    pub fn closed(&mut self, submap: Submap, store: &SubmapStore) -> Result<(), StageError> {
        if !self.is_first() {
            return store.save_part(&submap, self.part, self.parts);
        }
        self.unmerged.push_back(submap);
        Ok(())
    }

    /// The next closed submap that is whole.
    pub fn next_whole(
        &mut self,
        store: &SubmapStore,
        logic: &mut Mapper,
    ) -> Result<Option<Submap>, StageError> {
        let Some(oldest) = self.unmerged.front() else { return Ok(None) };
        let Some(parts) = store.load_parts(oldest.number, self.parts)? else { return Ok(None) };
        let Some(mut submap) = self.unmerged.pop_front() else { return Ok(None) };
        for part in &parts {
            logic.complete(submap.number, &part.tiles);
            submap.tiles.extend_from_slice(&part.tiles);
        }
        submap.tiles.sort_unstable_by_key(|tile| tile.key);
        Ok(Some(submap))
    }

    /// Whether closed submaps wait for parts.
    pub fn waits_for_parts(&self) -> bool {
        !self.unmerged.is_empty()
    }
}
