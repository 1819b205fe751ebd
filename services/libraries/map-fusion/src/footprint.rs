//! The area that a submap covers in the fused map.

use crate::resampling::Resampling;
use flockslam_evidence::{CellIndex, Submap, SubmapOutline, TileKey};
use flockslam_geometry::Pose;

/// Side of a block, cells.
const BLOCK_SIDE: u8 = 8;

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

    /// Nearly that of the submap with this outline, where `map_from_odom` takes the coordinates that its evidence was inserted in: the blocks
    /// of the map whose centres fall into blocks of the submap with evidence.
    pub fn of_outline(outline: &SubmapOutline, map_from_odom: Pose, cell_size_m: f64) -> Self {
        let Submap { odom_from_submap, cell_size_m: source_size_m, .. } = outline.emptied;
        let side = f64::from(BLOCK_SIDE);
        let resampling = Resampling::of_lattice(
            odom_from_submap,
            side * source_size_m,
            map_from_odom * odom_from_submap,
            side * cell_size_m,
        );
        let mut parts = Vec::new();
        for (key, blocks) in &outline.blocks {
            for block in (0..64).filter(|block| blocks >> block & 1 == 1) {
                let source = CellIndex::new(
                    key.x.saturating_mul(8).saturating_add(block % 8),
                    key.y.saturating_mul(8).saturating_add(block / 8),
                );
                for CellIndex { x, y } in resampling.targets(source) {
                    parts.push((TileKey { x: x >> 3, y: y >> 3 }, 1 << ((y & 7) * 8 + (x & 7))));
                }
            }
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
        parts.shrink_to_fit();
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
    use flockslam_evidence::{PackedCell, SubmapTile, TILE_CELLS, TILE_SIDE};

    #[test]
    fn an_outline_covers_nearly_what_its_submap_covers() {
        let cell = |offset: usize| match (offset % TILE_SIDE, offset / TILE_SIDE) {
            (3..61, 9..50) => PackedCell { occupied: 0, free: 900 },
            _ => PackedCell::UNKNOWN,
        };
        let tile = |x| {
            SubmapTile::new(TileKey { x, y: -1 }, Box::new(std::array::from_fn::<_, TILE_CELLS, _>(cell)))
        };
        let submap = Submap {
            odom_from_submap: Pose::new(-2.0, 0.5, 0.3),
            cell_size_m: 0.05,
            tiles: (-2..3).map(tile).collect(),
            ..Submap::default()
        };
        let outline = SubmapOutline::of(&submap);
        for turn in 0..8 {
            let map_from_odom = Pose::new(0.17 * f64::from(turn), 3.0, 0.8 * f64::from(turn));
            let nearly = Footprint::of_outline(&outline, map_from_odom, 0.05);
            let map_from_submap = map_from_odom * submap.odom_from_submap;
            let blocks = Footprint::of(&submap, map_from_submap, 0.05).blocks();
            let share = f64::from(nearly.blocks()) / f64::from(blocks);
            assert!((0.85..=1.0).contains(&share), "{share} of {blocks}");
        }
        let unmoved = Footprint::of_outline(&outline, Pose::IDENTITY, 0.05);
        assert_eq!(unmoved, Footprint::of(&submap, submap.odom_from_submap, 0.05));
    }
}
