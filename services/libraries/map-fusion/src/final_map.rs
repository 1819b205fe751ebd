//! The fused map of a final solution, with what is needed to clear cells of it and of its submaps.

use crate::fused_map::NotFused;
use crate::resampling::Resampling;
use crate::{Footprint, FusedMap};
use flockslam_evidence::{CellIndex, PackedCell, Submap, TileKey, TooFar};
use flockslam_geometry::Pose;
use std::collections::{BTreeMap, BTreeSet};

/// The sum of submaps at their final poses. Of each it keeps the cells with evidence for "occupied": so a submap need not be read again
/// when some of them are cleared.
#[derive(Debug)]
pub struct FinalMap {
    map: FusedMap,
    submaps: BTreeMap<u32, Summed>,
}

/// A submap as it is in the map.
#[derive(Debug)]
struct Summed {
    resampling: Resampling,
    footprint: Footprint,
    occupied: OccupiedCells,
}

/// The cells of a submap with evidence for "occupied" that are not cleared.
#[derive(Debug)]
struct OccupiedCells {
    /// Tiles in ascending order, each with the place behind its last cell.
    tiles: Box<[(TileKey, u32)]>,
    /// The cells of one tile after the other, with their offsets in ascending order.
    cells: Box<[(u16, PackedCell)]>,
}

impl FinalMap {
    /// An empty map with cells of this side, metres.
    ///
    /// # Panics
    /// When the side is not a positive number.
    pub fn new(cell_size_m: f64) -> Self {
        Self { map: FusedMap::new(cell_size_m), submaps: BTreeMap::new() }
    }

    /// The sum.
    pub fn map(&self) -> &FusedMap {
        &self.map
    }

    /// Adds a submap that is not in the map, where `map_from_odom` takes the coordinates that its evidence was inserted in.
    ///
    /// # Errors
    /// When its place is absurdly far from the others; then nothing changes.
    pub fn add(&mut self, submap: &Submap, map_from_odom: Pose) -> Result<(), TooFar> {
        let map_from_submap = map_from_odom * submap.odom_from_submap;
        let footprint = self.map.add(submap, map_from_submap)?;
        let resampling = Resampling::new(submap, map_from_submap, self.map.cell_size_m());
        let summed = Summed { resampling, footprint, occupied: OccupiedCells::of(submap) };
        self.submaps.insert(submap.number, summed);
        Ok(())
    }

    /// The submaps that know something in the blocks of these cells of the map.
    pub fn knowing(&self, cells: &[CellIndex]) -> Vec<u32> {
        let blocks = Footprint::of_cells(cells);
        let knows = self.submaps.iter().filter(|(_, summed)| summed.footprint.overlaps(&blocks));
        knows.map(|(number, _)| *number).collect()
    }

    /// Takes out of the map the evidence of a submap that makes these cells of the map occupied; gives the cells of the submap whose evidence
    /// it was, in odom: they are to be masked in it.
    ///
    /// # Errors
    /// When the submap is not in the map; then nothing changes.
    pub fn clear(&mut self, number: u32, cells: &[CellIndex]) -> Result<Vec<CellIndex>, NotFused> {
        let Summed { resampling, occupied, .. } = self.submaps.get_mut(&number).ok_or(NotFused(number))?;
        let sources = cells.iter().filter_map(|cell| resampling.source_cell(*cell));
        let mut taken = Vec::new();
        let mut evidence = Vec::new();
        for source in sources.collect::<BTreeSet<_>>() {
            if let Some(cell) = occupied.take(source) {
                taken.push(source);
                evidence.extend(resampling.targets(source).map(|target| (target, cell)));
            }
        }
        if self.map.withdraw_cells(&evidence) { Ok(taken) } else { Err(NotFused(number)) }
    }
}

impl OccupiedCells {
    fn of(submap: &Submap) -> Self {
        let (mut tiles, mut cells) = (Vec::new(), Vec::new());
        for tile in &submap.tiles {
            let all = (0..).zip(tile.cells.iter().copied());
            cells.extend(all.filter(|(offset, cell): &(u16, _)| {
                cell.occupied > 0 && !tile.is_cleared(usize::from(*offset))
            }));
            tiles.push((tile.key, cells.len() as u32));
        }
        Self { tiles: tiles.into(), cells: cells.into() }
    }

    /// The evidence of a cell, which is cleared by this.
    fn take(&mut self, cell: CellIndex) -> Option<PackedCell> {
        let tile = self.tiles.binary_search_by_key(&cell.tile(), |(key, _)| *key).ok()?;
        let start = tile.checked_sub(1).map_or(0, |before| self.tiles[before].1);
        let cells = &mut self.cells[start as usize..self.tiles[tile].1 as usize];
        let place = cells.binary_search_by_key(&(cell.offset() as u16), |(offset, _)| *offset).ok()?;
        let (_, evidence) = &mut cells[place];
        // Nothing is left for a second time.
        Some(std::mem::take(evidence)).filter(|evidence| !evidence.is_unknown())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fused_map::tests::{pose, submap};
    use flockslam_evidence::TILE_CELLS;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn cells_are_cleared_as_if_the_submap_had_been_added_with_them_masked(
            a in submap(), b in submap(), map_from_odom in pose(),
            picked in prop::collection::vec(any::<prop::sample::Index>(), 1..20)
        ) {
            let b = Submap { number: a.number + 1, ..b };
            let mut submaps = [a, b];
            let mut map = FinalMap::new(0.05);
            for submap in &submaps {
                map.add(submap, map_from_odom).unwrap();
            }
            let all: Vec<CellIndex> = map.map().tiles()
                .flat_map(|(key, _)| (0..TILE_CELLS).map(move |offset| key.cell(offset))).collect();
            prop_assume!(!all.is_empty());
            let cells: Vec<CellIndex> = picked.iter().map(|index| *index.get(&all)).collect();
            let knowing = map.knowing(&cells);
            for submap in &mut submaps {
                let cleared = map.clear(submap.number, &cells).unwrap();
                prop_assert!(cleared.is_empty() || knowing.contains(&submap.number));
                prop_assert_eq!(map.clear(submap.number, &cells), Ok(Vec::new()), "nothing is left to clear");
                for cell in cleared {
                    prop_assert!(submap.clear(cell).occupied > 0);
                }
            }
            prop_assert!(cells.iter().all(|cell| map.map().cell(*cell).occupied == 0));
            let mut masked = FusedMap::new(0.05);
            for submap in &submaps {
                masked.add(submap, map_from_odom * submap.odom_from_submap).unwrap();
            }
            prop_assert!(map.map() == &masked);
        }
    }

    #[test]
    fn a_submap_that_is_not_in_the_map_is_not_cleared() {
        let mut map = FinalMap::new(0.05);
        assert_eq!(map.clear(3, &[CellIndex::new(0, 0)]), Err(NotFused(3)));
    }
}
