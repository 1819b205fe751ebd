//! The area that a submap covers in the fused map.

use crate::resampling::Resampling;
use flockslam_evidence::{CellIndex, Submap, SubmapTile, TILE_SIDE, TileKey};
use flockslam_geometry::Pose;

/// Where a submap has evidence, cleared or not: this never changes once it is closed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct KnownCells {
    odom_from_submap: Pose,
    cell_size_m: f64,
    /// One bit for each cell, row by row.
    tiles: Vec<(TileKey, [u64; TILE_SIDE])>,
}

impl KnownCells {
    pub(crate) fn of(submap: &Submap) -> Self {
        let known = |tile: &SubmapTile| {
            let mut rows = [0; TILE_SIDE];
            for (row, cells) in rows.iter_mut().zip(tile.cells.as_chunks::<TILE_SIDE>().0) {
                let bits = cells.iter().enumerate().map(|(x, cell)| u64::from(!cell.is_unknown()) << x);
                *row = bits.sum();
            }
            (tile.key, rows)
        };
        Self {
            odom_from_submap: submap.odom_from_submap,
            cell_size_m: submap.cell_size_m,
            tiles: submap.tiles.iter().map(known).collect(),
        }
    }

    /// The same as [`Footprint::of`] the submap.
    pub(crate) fn footprint(&self, map_from_odom: Pose, cell_size_m: f64) -> Footprint {
        let map_from_submap = map_from_odom * self.odom_from_submap;
        let resampling =
            Resampling::of_lattice(self.odom_from_submap, self.cell_size_m, map_from_submap, cell_size_m);
        let mut parts = Vec::new();
        for (key, known) in &self.tiles {
            resampling.for_each_known(*key, known, |key, blocks| parts.push((key, blocks)));
        }
        Footprint::new(parts)
    }
}

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
