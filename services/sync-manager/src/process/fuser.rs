//! Connects the fused map with the store of submaps.

use crate::Settings;
use flockslam_evidence::CellIndex;
use flockslam_map_fusion::{FinalMap, FusedMap, Fusion, PlacedSubmap, Step, stale_cells, stored_map};
use flockslam_results::SubmapStore;
use flockslam_results::{StoredMap, Summary, write_map, write_map_rows};
use flockslam_stage::StageError;
use std::path::Path;

/// Loads stored submaps for the fusion.
pub struct Fuser {
    fusion: Fusion,
    /// The map of the final solution, once it is made.
    final_map: Option<FinalMap>,
    store: SubmapStore,
    known_area_m2: f64,
    /// Submaps with smaller numbers are of an imported map.
    kept_below: u32,
}

impl Fuser {
    /// An empty fused map, filled from this store.
    pub fn new(store: SubmapStore, settings: &Settings) -> Self {
        Self::retiring(store, settings.retire_covered_by)
    }

    fn retiring(store: SubmapStore, covered_by: usize) -> Self {
        let fusion = Fusion::new(covered_by);
        Self { fusion, final_map: None, store, known_area_m2: 0.0, kept_below: 0 }
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
        let mut fuser = Self::retiring(store, 0);
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
            if let Step::Place(placed) = step {
                self.fusion.take(placed, self.store.load_outline(placed.number)?);
            }
        }
        let covered = self.fusion.covered(self.kept_below);
        for number in &covered {
            if let Some(emptied) = self.fusion.retire(*number)
                && let Err(error) = self.store.save(&emptied)
            {
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
        self.final_map.as_ref().map(FinalMap::map)
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
    pub fn clear(&mut self, cells: &[CellIndex]) -> Result<(), StageError> {
        let Some(final_map) = &mut self.final_map else { return Ok(()) };
        for number in final_map.knowing(cells).into_iter().filter(|number| *number >= self.kept_below) {
            match final_map.clear(number, cells) {
                Ok(masked) if masked.is_empty() => {}
                Ok(masked) => self.store.mask(number, &masked)?,
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
        (self.known_area_m2, self.final_map) = (0.0, None);
        for PlacedSubmap { number, map_from_odom } in self.fusion.parts(submaps_in_map, closed) {
            let mut submap = self.store.load(number)?;
            self.known_area_m2 += submap.known_area_m2();
            let sum = self.final_map.get_or_insert_with(|| FinalMap::new(submap.cell_size_m));
            if number >= self.kept_below {
                let stale = stale_cells(&submap, map_from_odom, sum.map());
                if !stale.is_empty() {
                    self.store.mask(number, &stale)?;
                    stale.into_iter().for_each(|cell| {
                        submap.clear(cell);
                    });
                }
            }
            sum.add(&submap, map_from_odom).map_err(|far| StageError::file("the fused map", far))?;
        }
        Ok(())
    }

    /// The mapper may have stored a submap once more after it retired, with the cells that it has cleared.
    fn empty_retired(&self) -> Result<(), StageError> {
        for number in self.fusion.retired() {
            let outline = self.store.load_outline(number)?;
            if !outline.blocks.is_empty() {
                self.store.save(&outline.emptied)?;
            }
        }
        Ok(())
    }
}
