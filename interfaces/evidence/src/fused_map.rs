use crate::{
    Cell, CellIndex, PackedCell, Submap, SubmapTile, TILE_CELLS, TILE_SIDE, TileDirectory, TileKey, TooFar,
    floor,
};
use flockslam_geometry::{Point, Pose};

/// The sum of submaps at the poses of a layout, in a lattice of its own.
///
/// Each submap is resampled to the nearest cell and added as integers: the order does not matter, and a submap can be
/// taken out again exactly. Fusing the same submap twice counts its evidence twice: keys are the caller's duty.
#[derive(Clone, Debug)]
pub struct FusedMap {
    cell_size_m: f64,
    tiles: TileDirectory<Box<FusedTile>>,
}

/// Cells of a tile of the fused map.
type FusedTile = [Cell; TILE_CELLS];

/// A submap cannot be taken out: it is not in the map at this pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("submap {0} is not in the fused map at this pose")]
pub struct NotFused(pub u32);

impl FusedMap {
    /// An empty map with cells of this side, metres.
    ///
    /// # Panics
    /// When the side is not a positive number.
    pub fn new(cell_size_m: f64) -> Self {
        assert!(cell_size_m.is_finite() && cell_size_m > 0.0, "cells of {cell_size_m} m");
        Self { cell_size_m, tiles: TileDirectory::default() }
    }

    /// Side of a cell, metres.
    pub fn cell_size_m(&self) -> f64 {
        self.cell_size_m
    }

    /// Adds a submap whose reference pose lies at `map_from_submap`. Cleared cells count as unknown.
    ///
    /// # Errors
    /// When the submap lies absurdly far from the others; then part of it may have been added.
    pub fn add(&mut self, submap: &Submap, map_from_submap: Pose) -> Result<(), TooFar> {
        let cell_size_m = self.cell_size_m;
        let mut result = Ok(());
        for tile in &submap.tiles {
            resample(tile, submap, map_from_submap, cell_size_m, |index, evidence| {
                if result.is_ok() {
                    result = self.cell_mut(index).map(|cell| *cell = cell.combine(evidence));
                }
            });
        }
        result
    }

    /// Takes out a submap that was added at this pose with these cells cleared.
    ///
    /// # Errors
    /// When it cannot have been added so; then nothing changes.
    pub fn withdraw(&mut self, submap: &Submap, map_from_submap: Pose) -> Result<(), NotFused> {
        let mut fits = true;
        for tile in &submap.tiles {
            resample(tile, submap, map_from_submap, self.cell_size_m, |index, evidence| {
                fits &= self.cell(index).withdraw(evidence).is_some();
            });
        }
        if !fits {
            return Err(NotFused(submap.number));
        }
        let mut touched = Vec::new();
        for tile in &submap.tiles {
            let cell_size_m = self.cell_size_m;
            resample(tile, submap, map_from_submap, cell_size_m, |index, evidence| {
                let cells = self.tiles.get_mut(index.tile()).expect("checked above");
                let left = cells[index.offset()].withdraw(evidence);
                cells[index.offset()] = left.expect("checked above: each cell is visited once");
                if touched.last() != Some(&index.tile()) {
                    touched.push(index.tile());
                }
            });
        }
        for key in touched {
            if self.tiles.get(key).is_some_and(|cells| cells.iter().all(|cell| cell.is_unknown())) {
                self.tiles.remove(key);
            }
        }
        Ok(())
    }

    /// Evidence of a cell.
    pub fn cell(&self, index: CellIndex) -> Cell {
        self.tiles.get(index.tile()).map_or(Cell::UNKNOWN, |cells| cells[index.offset()])
    }

    /// All tiles with their cells (index = y·64 + x), row by row.
    pub fn tiles(&self) -> impl Iterator<Item = (TileKey, &[Cell; TILE_CELLS])> {
        self.tiles.iter().map(|(key, cells)| (key, &**cells))
    }

    /// Whether nothing is in the map.
    pub fn is_empty(&self) -> bool {
        self.tiles.is_empty()
    }

    /// The smallest and the greatest cell index with evidence, both included.
    pub fn bounds(&self) -> Option<(CellIndex, CellIndex)> {
        let known = self.tiles().flat_map(|(key, cells)| {
            let known = cells.iter().enumerate().filter(|(_, cell)| !cell.is_unknown());
            known.map(move |(offset, _)| key.cell(offset))
        });
        known.fold(None, |bounds, c| {
            let (low, high) = bounds.unwrap_or((c, c));
            Some((
                CellIndex::new(low.x.min(c.x), low.y.min(c.y)),
                CellIndex::new(high.x.max(c.x), high.y.max(c.y)),
            ))
        })
    }

    fn cell_mut(&mut self, index: CellIndex) -> Result<&mut Cell, TooFar> {
        let key = index.tile();
        if self.tiles.get(key).is_none() {
            self.tiles.set(key, Box::new([Cell::UNKNOWN; TILE_CELLS]))?;
        }
        Ok(&mut self.tiles.get_mut(key).expect("just set")[index.offset()])
    }
}

impl PartialEq for FusedMap {
    fn eq(&self, other: &Self) -> bool {
        self.cell_size_m == other.cell_size_m && self.tiles().eq(other.tiles())
    }
}

/// Calls `visit` for each cell of the target lattice whose centre falls into a cell of `tile` with evidence.
///
/// Going from target to source leaves no holes and gives each target cell one source cell, whatever the rotation.
fn resample(
    tile: &SubmapTile,
    submap: &Submap,
    map_from_submap: Pose,
    cell_size_m: f64,
    mut visit: impl FnMut(CellIndex, Cell),
) {
    let map_from_odom = map_from_submap * submap.odom_from_submap.inverse();
    let odom_from_map = map_from_odom.inverse();
    let (low, high) = target_bounds(tile.key, submap.cell_size_m, map_from_odom, cell_size_m);
    let (sin, cos) = odom_from_map.heading_rad.sin_cos();
    for y in low.y..=high.y {
        for x in low.x..=high.x {
            let (cx, cy) = ((f64::from(x) + 0.5) * cell_size_m, (f64::from(y) + 0.5) * cell_size_m);
            let source = CellIndex::new(
                floor((cos * cx - sin * cy + odom_from_map.x_m) / submap.cell_size_m),
                floor((sin * cx + cos * cy + odom_from_map.y_m) / submap.cell_size_m),
            );
            if source.tile() != tile.key {
                continue;
            }
            let evidence: PackedCell = tile.cell(source.offset());
            if !evidence.is_unknown() {
                visit(CellIndex::new(x, y), evidence.unpack());
            }
        }
    }
}

/// Target cells that a source tile can touch.
fn target_bounds(
    key: TileKey,
    source_size_m: f64,
    map_from_odom: Pose,
    cell_size_m: f64,
) -> (CellIndex, CellIndex) {
    let side_m = source_size_m * TILE_SIDE as f64;
    let (x, y) = (f64::from(key.x) * side_m, f64::from(key.y) * side_m);
    let corners = [(x, y), (x + side_m, y), (x, y + side_m), (x + side_m, y + side_m)]
        .map(|(x, y)| map_from_odom.apply(Point::new(x, y)));
    let cell = |m: f64, margin: i32| floor(m / cell_size_m).saturating_add(margin);
    let least = |f: fn(&Point) -> f64| corners.iter().map(f).fold(f64::INFINITY, f64::min);
    let most = |f: fn(&Point) -> f64| corners.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
    (
        CellIndex::new(cell(least(|p| p.x_m), -1), cell(least(|p| p.y_m), -1)),
        CellIndex::new(cell(most(|p| p.x_m), 1), cell(most(|p| p.y_m), 1)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::submap_bytes::tests::submap;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose> {
        (-5.0..5.0f64, -5.0..5.0f64, -3.0..3.0f64).prop_map(|(x, y, heading)| Pose::new(x, y, heading))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_order_does_not_matter_and_withdrawal_is_exact(
            a in submap(), b in submap(), pose_a in pose(), pose_b in pose()
        ) {
            let (mut ab, mut ba, mut only_b) = (FusedMap::new(0.05), FusedMap::new(0.05), FusedMap::new(0.05));
            ab.add(&a, pose_a).unwrap();
            ab.add(&b, pose_b).unwrap();
            ba.add(&b, pose_b).unwrap();
            ba.add(&a, pose_a).unwrap();
            only_b.add(&b, pose_b).unwrap();
            prop_assert_eq!(&ab, &ba);
            ab.withdraw(&a, pose_a).unwrap();
            prop_assert_eq!(&ab, &only_b);
            ab.withdraw(&b, pose_b).unwrap();
            prop_assert!(ab.is_empty() && ab.bounds().is_none());
        }

        #[test]
        fn at_its_own_pose_a_submap_is_copied_cell_by_cell(a in submap()) {
            let mut map = FusedMap::new(0.05);
            map.add(&a, a.odom_from_submap).unwrap();
            for tile in &a.tiles {
                for offset in 0..TILE_CELLS {
                    let index = tile.key.cell(offset);
                    prop_assert_eq!(map.cell(index), a.cell(index).unpack());
                }
            }
        }
    }

    #[test]
    fn what_is_not_in_the_map_cannot_be_taken_out() {
        let key = TileKey { x: 0, y: 0 };
        let mut tile = SubmapTile::new(key, Box::new([PackedCell { occupied: 5, free: 1 }; TILE_CELLS]));
        tile.clear(7);
        let mut submap = Submap {
            number: 4,
            insertions: 1,
            first: 0,
            last: 0,
            odom_from_submap: Pose::IDENTITY,
            cell_size_m: 0.05,
            tiles: vec![tile],
        };
        let mut map = FusedMap::new(0.05);
        map.add(&submap, Pose::IDENTITY).unwrap();
        let before = map.clone();
        assert_eq!(map.withdraw(&submap, Pose::new(1.0, 0.0, 0.0)), Err(NotFused(4)));
        assert_eq!(map, before);
        submap.tiles[0].cleared = [0; TILE_SIDE];
        assert_eq!(map.withdraw(&submap, Pose::IDENTITY), Err(NotFused(4)));
        assert_eq!(map.bounds(), Some((CellIndex::new(0, 0), CellIndex::new(63, 63))));
    }
}
