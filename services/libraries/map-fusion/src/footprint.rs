//! The area that a submap covers in the fused map.

use crate::resampling::Resampling;
use flockslam_evidence::{CellIndex, Submap, TileKey};
use flockslam_geometry::Pose;

/// Blocks of 8 × 8 cells of the fused map in which a submap has evidence.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Tiles in ascending order, each with its blocks (bit = row of blocks · 8 + column), never none.
    tiles: Vec<(TileKey, u64)>,
}

impl Footprint {
    /// That of a submap whose reference pose lies at `map_from_submap`, in a map with cells of this side, metres.
    pub fn of(submap: &Submap, map_from_submap: Pose, cell_size_m: f64) -> Self {
        let resampling = Resampling::new(submap, map_from_submap, cell_size_m);
        let mut parts = Vec::new();
        for tile in &submap.tiles {
            resampling.for_each(tile, |part| parts.push((part.key, part.blocks)));
        }
        Self::new(parts)
    }

    /// The union of parts.
    pub(crate) fn new(mut parts: Vec<(TileKey, u64)>) -> Self {
        parts.sort_unstable_by_key(|(key, _)| *key);
        parts.dedup_by(|(key, blocks), (before, all)| {
            let same = key == before;
            if same {
                *all |= *blocks;
            }
            same
        });
        Self { tiles: parts }
    }

    /// The blocks of cells of the fused map.
    pub fn of_cells(cells: &[CellIndex]) -> Self {
        let block = |cell: &CellIndex| {
            let (tile, place) = (cell.tile(), cell.offset());
            (tile, 1u64 << (place >> 9 << 3 | (place >> 3 & 7)))
        };
        Self::new(cells.iter().map(block).collect())
    }

    /// Whether two have a block in common.
    pub fn overlaps(&self, other: &Footprint) -> bool {
        let mut rest = other.tiles.iter().peekable();
        self.tiles.iter().any(|(key, blocks)| {
            while rest.next_if(|(other, _)| other < key).is_some() {}
            rest.peek().is_some_and(|(other, others)| other == key && blocks & others != 0)
        })
    }

    /// Its tiles in ascending order, each with its blocks (bit = row of blocks · 8 + column).
    pub fn tiles(&self) -> &[(TileKey, u64)] {
        &self.tiles
    }

    /// Number of blocks.
    pub fn blocks(&self) -> u32 {
        self.tiles.iter().map(|(_, blocks)| blocks.count_ones()).sum()
    }
}
