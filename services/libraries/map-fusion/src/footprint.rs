//! The area that a submap covers in the fused map.

use flockslam_evidence::TileKey;

/// Blocks of 8 × 8 cells of the fused map in which a submap has evidence.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Tiles in ascending order, each with its blocks (bit = row of blocks · 8 + column), never none.
    tiles: Vec<(TileKey, u64)>,
}

impl Footprint {
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

    /// Its tiles in ascending order, each with its blocks (bit = row of blocks · 8 + column).
    pub fn tiles(&self) -> &[(TileKey, u64)] {
        &self.tiles
    }

    /// Number of blocks.
    pub fn blocks(&self) -> u32 {
        self.tiles.iter().map(|(_, blocks)| blocks.count_ones()).sum()
    }
}
