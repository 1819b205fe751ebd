//! The mapper, run again: each recorded commit is computed from its scan, its pose and the cells that were cleared before.

use super::grid_copy::TileChanges;
use flockslam_evidence::{Submap, TileKey};
use flockslam_mapper::{Mapper, Settings};
use flockslam_messages::{ClearedCell, Commit, PoseEstimate, ScanView};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Mappers, one process after the other, and the closed submaps that they store.
pub struct MapperRerun {
    settings: Settings,
    logic: Mapper,
    /// The present process.
    process: u64,
    /// Number of its last commit.
    number: u64,
    /// Accepted scans with a sequence below this are in the map.
    applied: u64,
    store: BTreeMap<u32, Submap>,
}

impl MapperRerun {
    /// Before the first process.
    pub fn new(settings: Settings) -> Self {
        Self {
            logic: Mapper::new(settings.clone()),
            settings,
            process: 0,
            number: 0,
            applied: 0,
            store: BTreeMap::new(),
        }
    }

    /// Whether a commit is of another process than the last one.
    pub fn is_new(&self, commit: &Commit) -> bool {
        commit.name.mapper != self.process
    }

    /// Goes on with the process of this commit; gives how many commits before it are missing.
    pub fn follow(&mut self, commit: &Commit) -> u64 {
        if self.is_new(commit) {
            (self.process, self.number) = (commit.name.mapper, 0);
            self.restart(commit.resumed_submaps);
        }
        let missing = commit.name.number.saturating_sub(self.number + 1);
        self.number = commit.name.number;
        missing
    }

    /// A new process begins with the submaps that its predecessor has stored.
    fn restart(&mut self, submaps: u32) {
        // What was closed but not stored when the process was killed was lost with it.
        self.store.retain(|number, _| *number < submaps);
        self.logic = Mapper::new(self.settings.clone());
        self.applied = 0;
        let mut inserted = 0;
        for submap in self.store.values() {
            inserted += u64::from(submap.insertions);
            self.applied = submap.last + 1;
            self.logic.resume(submap.clone(), inserted);
        }
    }

    /// The scans that a new process, whose first commit this is, has inserted before: accepted ones from the first to the second.
    pub fn recovered_scans(&self, commit: &Commit) -> Option<RangeInclusive<u64>> {
        (commit.all_tiles == 1 && commit.name.number == 1).then_some(self.applied..=commit.id.sequence)
    }

    /// Inserts a scan; gives what changed, with the commit as it is now computed.
    pub fn insert(
        &mut self,
        commit: &Commit,
        scan: ScanView<'_>,
        pose: &PoseEstimate,
        cleared: &[ClearedCell],
    ) -> (Commit, TileChanges) {
        self.applied = pose.id.sequence + 1;
        let insertion = self.logic.insert(scan, pose, cleared);
        let made = Commit {
            generation: insertion.generation,
            tiles: insertion.changed.len() as u32,
            active_submap: insertion.active_submap,
            ..*commit
        };
        let (closed, changed, retired) =
            (insertion.closed, insertion.changed.to_vec(), insertion.retired.to_vec());
        let mut changes: TileChanges = retired.into_iter().map(|key| (key, None)).collect();
        self.add_tiles(changed.into_iter(), &mut changes);
        for submap in closed.into_iter().chain(self.logic.take_cleared()) {
            // As it comes back from the store.
            let stored = Submap::decode(&submap.encode()).expect("what is encoded can be decoded");
            self.store.insert(stored.number, stored);
        }
        (made, changes)
    }

    /// All tiles once more.
    pub fn publish_again(&self, commit: &Commit) -> (Commit, TileChanges) {
        let mut changes = TileChanges::new();
        self.add_tiles(self.logic.live_tiles(), &mut changes);
        let (generation, active_submap) = (self.logic.generation(), self.logic.active_submap());
        (Commit { generation, active_submap, tiles: changes.len() as u32, ..*commit }, changes)
    }

    fn add_tiles(&self, keys: impl Iterator<Item = TileKey>, changes: &mut TileChanges) {
        for key in keys {
            let mut tile = flockslam_evidence::Tile::unknown(0);
            self.logic.write_tile(key, &mut tile);
            changes.push((key, Some(Arc::from(tile))));
        }
    }
}
