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
    tiles: Vec<KnownTile>,
}

impl KnownCells {
    pub(crate) fn of(submap: &Submap) -> Self {
        Self {
            odom_from_submap: submap.odom_from_submap,
            cell_size_m: submap.cell_size_m,
            tiles: submap.tiles.iter().map(KnownTile::of).collect(),
        }
    }

    /// The same as [`Footprint::of`] the submap.
    pub(crate) fn footprint(&self, map_from_odom: Pose, cell_size_m: f64) -> Footprint {
        let map_from_submap = map_from_odom * self.odom_from_submap;
        let resampling =
            Resampling::of_lattice(self.odom_from_submap, self.cell_size_m, map_from_submap, cell_size_m);
        let mut parts = Vec::new();
        for tile in &self.tiles {
            resampling.for_each_known(tile.key, &tile.rows(), |key, blocks| parts.push((key, blocks)));
        }
        Footprint::new(parts)
    }
}

/// The known cells of a tile. A block of 8 × 8 cells that is known in part takes one word, any other none.
#[derive(Clone, Debug, PartialEq)]
struct KnownTile {
    key: TileKey,
    /// Blocks of which something is known (bit = row of blocks · 8 + column), and those of which all is.
    some: u64,
    all: u64,
    /// The cells of the others, one bit each, row by row.
    partial: Box<[u64]>,
}

impl KnownTile {
    fn of(tile: &SubmapTile) -> Self {
        let mut blocks = [0u64; TILE_SIDE];
        for (offset, _) in tile.cells.iter().enumerate().filter(|(_, cell)| !cell.is_unknown()) {
            let (block, bit) = block_and_bit(offset);
            blocks[block] |= 1 << bit;
        }
        let which = |is: fn(u64) -> bool| {
            blocks.iter().enumerate().fold(0, |bits, (at, cells)| bits | u64::from(is(*cells)) << at)
        };
        let partial = blocks.iter().copied().filter(|cells| !matches!(*cells, 0 | u64::MAX)).collect();
        Self {
            key: tile.key,
            some: which(|cells| cells != 0),
            all: which(|cells| cells == u64::MAX),
            partial,
        }
    }

    /// The known cells, one bit each, row by row.
    fn rows(&self) -> [u64; TILE_SIDE] {
        let mut rows = [0; TILE_SIDE];
        let mut partial = self.partial.iter();
        for block in 0..TILE_SIDE {
            let cells = match (self.some >> block & 1, self.all >> block & 1) {
                (0, _) => continue,
                (_, 1) => u64::MAX,
                _ => *partial.next().expect("a word for each block in part"),
            };
            for (y, row) in cells.to_le_bytes().into_iter().enumerate() {
                rows[block / 8 * 8 + y] |= u64::from(row) << (block % 8 * 8);
            }
        }
        rows
    }
}

/// The block of 8 × 8 cells that a cell of a tile is in, and its place there, both row by row.
fn block_and_bit(offset: usize) -> (usize, usize) {
    let (x, y) = (offset % TILE_SIDE, offset / TILE_SIDE);
    (y / 8 * 8 + x / 8, y % 8 * 8 + x % 8)
}

/// Blocks of 8 × 8 cells of the fused map in which a submap has evidence.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Tiles in ascending order, each with its blocks (bit = row of blocks · 8 + column), never none.
    tiles: Vec<(TileKey, u64)>,
}

impl Footprint {
    /// That of a submap whose reference pose is at `map_from_submap`, in a map with cells of this side, metres.
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

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{PackedCell, TILE_CELLS};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn known_cells_round_trip(blocks in proptest::collection::vec(
            prop_oneof![Just(0), Just(u64::MAX), any::<u64>()], TILE_SIDE
        )) {
            let mut tile =
                SubmapTile::new(TileKey { x: 3, y: -2 }, Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
            for offset in 0..TILE_CELLS {
                let (block, bit) = block_and_bit(offset);
                tile.cells[offset].free = (blocks[block] >> bit & 1) as u16;
            }
            let rows = KnownTile::of(&tile).rows();
            for (offset, cell) in tile.cells.iter().enumerate() {
                prop_assert_eq!(rows[offset / TILE_SIDE] >> (offset % TILE_SIDE) & 1 == 1, !cell.is_unknown());
            }
        }
    }
}
