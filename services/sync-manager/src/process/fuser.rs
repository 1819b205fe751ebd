//! Connects the fused map with the store of submaps.

use crate::Settings;
use flockslam_evidence::CellIndex;
use flockslam_map_fusion::FusedMap;
use flockslam_map_fusion::PlacedSubmap;
use flockslam_map_fusion::stale_cells;
use flockslam_map_fusion::stored_map;
use flockslam_map_fusion::{Fusion, Step};
use flockslam_results::SubmapStore;
use flockslam_results::{StoredMap, Summary, write_map, write_map_rows};
use flockslam_stage::StageError;
use std::path::Path;

/// Loads stored submaps for the fusion.
pub struct Fuser {
    fusion: Fusion,
    store: SubmapStore,
    known_area_m2: f64,
    /// Submaps with smaller numbers are of an imported map.
    kept_below: u32,
}

impl Fuser {
    /// An empty fused map, filled from this store.
    pub fn new(store: SubmapStore, settings: &Settings) -> Self {
        Self { fusion: Fusion::new(settings.retire_covered_by), store, known_area_m2: 0.0, kept_below: 0 }
    }

    /// Submaps with numbers below this are of an imported map: they stay as they are, and never retire.
    pub fn keep_below(&mut self, number: u32) {
        self.kept_below = number;
    }

    /// A fused map of its own, of these submaps alone, as they are stored.
    ///
    /// # Errors
    /// When the store fails, or a submap is absurdly far from the others.
    pub fn of_part(store: SubmapStore, submaps: &[PlacedSubmap]) -> Result<StoredMap, StageError> {
        let mut fuser = Self { fusion: Fusion::new(0), store, known_area_m2: 0.0, kept_below: 0 };
        let closed = fuser.store.count();
        fuser.take_all(submaps, closed)?;
        Ok(fuser.stored_map())
    }

    /// Brings the parts of the fused map a few steps closer to a solution, of which the first `closed` submaps are stored; gives the submaps that have retired now.
    ///
    /// # Errors
    /// When the store fails.
    pub fn follow(&mut self, submaps_in_map: &[PlacedSubmap], closed: u32) -> Result<Vec<u32>, StageError> {
        for step in self.fusion.steps(submaps_in_map, closed) {
            if self.fusion.take_known(step) {
                continue;
            }
            let submap = self.store.load(step.number())?;
            if let Err(far) = self.fusion.take(step, submap) {
                tracing::warn!(%far, number = step.number(), "a submap is not in the fused map");
            }
        }
        let covered = self.fusion.covered(self.kept_below);
        for number in &covered {
            let emptied = self.fusion.retire(self.store.load(*number)?);
            if let Err(error) = self.store.save(&emptied) {
                // It takes more room than it needs; at the end it is emptied again.
                tracing::warn!(%error, number, "a submap that has retired is not emptied");
            }
        }
        Ok(covered)
    }

    /// Area that the closed submaps know, m².
    pub fn area_m2(&self) -> f64 {
        self.fusion.area_m2()
    }

    /// Makes the fused map of the final solution: it is the sum over the stored submaps at their poses then.
    ///
    /// # Errors
    /// When the store fails, or a submap is absurdly far from the others.
    pub fn finish(&mut self, submaps_in_map: &[PlacedSubmap]) -> Result<(), StageError> {
        // The last scans may carry the number of a submap that nothing was inserted in.
        let closed = self.store.count();
        self.take_all(submaps_in_map, closed)?;
        self.empty_retired()
    }

    /// The fused map, once it is finished; `None` when there is no submap.
    pub fn map(&self) -> Option<&FusedMap> {
        self.fusion.map()
    }

    /// The fused map, once it is finished, on the rectangle that has evidence.
    pub fn stored_map(&self) -> StoredMap {
        self.map().map_or_else(StoredMap::empty, stored_map)
    }

    /// Writes the fused map, once it is finished, into a set's results.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write_map(&self, directory: &Path) -> Result<(), StageError> {
        match self.map() {
            Some(map) => write_map_rows(directory, &map.shape(), |push| map.for_each_row(push))?,
            None => write_map(directory, &StoredMap::empty())?,
        }
        Ok(())
    }

    /// Masks the evidence that makes these cells of the map occupied, in all submaps of the final solution.
    ///
    /// # Errors
    /// When the store fails.
    pub fn clear(&mut self, cells: &[CellIndex], submaps_in_map: &[PlacedSubmap]) -> Result<(), StageError> {
        let occupying = self.fusion.occupying(submaps_in_map, cells);
        for placed in occupying.into_iter().filter(|placed| placed.number >= self.kept_below) {
            let mut submap = self.store.load(placed.number)?;
            match self.fusion.clear(&mut submap, cells) {
                Ok(false) => {}
                Ok(true) => self.store.save_cleared(&submap)?,
                Err(error) => tracing::warn!(%error, "what was moved since stays in it"),
            }
        }
        Ok(())
    }

    /// Number of submaps that have been in the map or are in it: those of the final solution that are stored (the last scans may
    /// carry the number of one that nothing was inserted in), and those that have retired.
    pub fn known(&self, submaps_in_map: &[PlacedSubmap]) -> u64 {
        let closed = self.store.count();
        let placed =
            |number: &u32| submaps_in_map.binary_search_by_key(number, |placed| placed.number).is_ok();
        let stored = submaps_in_map.iter().filter(|placed| placed.number < closed).count();
        (stored + self.fusion.retired().filter(|number| !placed(number)).count()) as u64
    }

    /// Reports the submaps, once the map is finished.
    pub fn report(&self, summary: &mut Summary) {
        summary.submaps_retired = self.fusion.retired().count() as u64;
        summary.submap_bytes = self.store.bytes();
        summary.submap_area_m2 = self.known_area_m2;
    }

    /// Adds all submaps, and masks in each the cells that newer ones have found free: the mapper clears within its window only.
    fn take_all(&mut self, submaps_in_map: &[PlacedSubmap], closed: u32) -> Result<(), StageError> {
        self.known_area_m2 = 0.0;
        for step in self.fusion.last_steps(submaps_in_map, closed) {
            let mut submap = self.store.load(step.number())?;
            self.known_area_m2 += submap.known_area_m2();
            let may_change = step.number() >= self.kept_below;
            if let (Some(newer), Step::Place(placed), true) = (self.fusion.map(), step, may_change) {
                let stale = stale_cells(&submap, placed.map_from_odom, newer);
                if !stale.is_empty() {
                    for cell in stale {
                        submap.clear(cell);
                    }
                    self.store.save_cleared(&submap)?;
                }
            }
            self.fusion.take(step, submap).map_err(|far| StageError::file("the fused map", far))?;
        }
        Ok(())
    }

    /// The mapper may have stored a submap once more after it retired, with the cells that it has cleared.
    fn empty_retired(&self) -> Result<(), StageError> {
        for number in self.fusion.retired() {
            let mut submap = self.store.load(number)?;
            if !submap.tiles.is_empty() {
                submap.tiles.clear();
                self.store.save(&submap)?;
            }
        }
        Ok(())
    }
}
