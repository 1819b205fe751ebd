//! The fused map: submaps and their poses go in, the sum of their evidence in one lattice comes out. A submap can be taken
//! out again.

use crate::Footprint;
use crate::resampling::Resampling;
use flockslam_evidence::{
    BlockTile, Cell, CellIndex, PackedCell, Submap, TILE_CELLS, TILE_SIDE, TileDirectory, TileKey, TooFar,
};
use flockslam_geometry::{Point, Pose};
use flockslam_results::{MapShape, StoredMap};

/// The sum of submaps at the poses of a solution, in a lattice of its own.
///
/// Each submap is resampled to the nearest cell and added as integers: the order does not matter, and a submap can be
/// taken out again exactly. Fusing the same submap twice counts its evidence twice: keys are the caller's duty.
///
/// ```
/// # use flockslam_map_fusion::FusedMap;
/// # use flockslam_evidence::{CellIndex, PackedCell, Submap, SubmapTile, TILE_CELLS};
/// # use flockslam_geometry::Pose;
/// let wall = CellIndex::new(3, 5);
/// let mut cells = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
/// cells[wall.offset()] = PackedCell { occupied: 900, free: 20 };
/// # let (tiles, odom_from_submap) = (vec![SubmapTile::new(wall.tile(), cells)], Pose::IDENTITY);
/// # let (number, trajectory, insertions, first, last, cell_size_m) = (0, 0, 1, 0, 0, 0.05);
/// let submap = Submap { number, trajectory, insertions, first, last, odom_from_submap, cell_size_m, tiles };
/// let map_from_submap = Pose::new(1.0, 0.0, 0.0);
/// let mut map = FusedMap::new(0.05);
/// map.add(&submap, map_from_submap)?;
/// // One metre is twenty cells.
/// assert_eq!(map.cell(CellIndex::new(23, 5)).occupied, 900);
/// map.withdraw(&submap, map_from_submap)?;
/// assert!(map.is_empty());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct FusedMap {
    cell_size_m: f64,
    tiles: TileDirectory<Box<BlockTile>>,
}

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

    /// Adds a submap whose reference pose is at `map_from_submap`; gives where it has evidence, cleared or not. Cleared cells add nothing.
    ///
    /// # Errors
    /// When the submap is absurdly far from the others; then nothing changes.
    pub fn add(&mut self, submap: &Submap, map_from_submap: Pose) -> Result<Footprint, TooFar> {
        let resampling = Resampling::new(submap, map_from_submap, self.cell_size_m);
        let mut parts = Vec::new();
        let (mut done, mut result) = (0, Ok(()));
        for tile in &submap.tiles {
            resampling.for_each(tile, |part| {
                parts.push((part.key, part.blocks));
                if result.is_ok() && !part.cells.is_empty() {
                    result = self.tile_mut(part.key).map(|cells| add(cells, part.cells));
                    done += if result.is_ok() { part.cells.len() } else { 0 };
                }
            });
        }
        if result.is_err() {
            self.undo(submap, &resampling, done, |cells, evidence| {
                withdraw(cells, evidence);
            });
            self.drop_empty(parts.iter().map(|(key, _)| *key).collect());
        }
        result.map(|()| Footprint::new(parts))
    }

    /// Takes out evidence of single cells; false when it cannot have been added so: then nothing changes.
    pub(crate) fn withdraw_cells(&mut self, evidence: &[(CellIndex, PackedCell)]) -> bool {
        let mut left = Vec::with_capacity(evidence.len());
        for (target, cell) in evidence {
            match self.cell(*target).withdraw(cell.unpack()) {
                Some(rest) => left.push(rest),
                None => return false,
            }
        }
        for ((target, _), left) in evidence.iter().zip(left) {
            if let Some(tile) = self.tiles.get_mut(target.tile()) {
                tile.set_cell(target.offset(), left);
            }
        }
        self.drop_empty(evidence.iter().map(|(target, _)| target.tile()).collect());
        true
    }

    /// Takes out a submap that was added at this pose with these cells cleared.
    ///
    /// # Errors
    /// When it cannot have been added so; then nothing changes.
    pub fn withdraw(&mut self, submap: &Submap, map_from_submap: Pose) -> Result<(), NotFused> {
        let resampling = Resampling::new(submap, map_from_submap, self.cell_size_m);
        let mut touched = Vec::new();
        let (mut done, mut fits) = (0, true);
        for tile in &submap.tiles {
            resampling.for_each(tile, |part| {
                if !fits || part.cells.is_empty() {
                    return;
                }
                touched.push(part.key);
                let count = self.tiles.get_mut(part.key).map_or(0, |cells| withdraw(cells, part.cells));
                done += count;
                fits = count == part.cells.len();
            });
        }
        if !fits {
            self.undo(submap, &resampling, done, add);
            return Err(NotFused(submap.number));
        }
        self.drop_empty(touched);
        Ok(())
    }

    /// Undoes the change of the first `count` cells of a submap.
    fn undo(
        &mut self,
        submap: &Submap,
        resampling: &Resampling,
        mut count: usize,
        back: fn(&mut BlockTile, &[(u16, PackedCell)]),
    ) {
        for tile in &submap.tiles {
            resampling.for_each(tile, |part| {
                let done = &part.cells[..count.min(part.cells.len())];
                count -= done.len();
                if let Some(cells) = self.tiles.get_mut(part.key) {
                    back(cells, done);
                }
            });
        }
    }

    /// Drops those of the tiles that hold no evidence any more.
    fn drop_empty(&mut self, mut keys: Vec<TileKey>) {
        keys.sort_unstable();
        keys.dedup();
        for key in keys {
            if self.tiles.get(key).is_some_and(|tile| tile.is_empty()) {
                self.tiles.remove(key);
            }
        }
    }

    /// Evidence of a cell.
    pub fn cell(&self, index: CellIndex) -> Cell {
        self.tiles.get(index.tile()).map_or(Cell::UNKNOWN, |cells| cells.cell(index.offset()))
    }

    /// The cells of a tile (index = y·64 + x), if there is evidence in it.
    pub fn tile(&self, key: TileKey) -> Option<Box<[Cell; TILE_CELLS]>> {
        self.tiles.get(key).map(|tile| tile.cells())
    }

    /// All tiles with their cells (index = y·64 + x), row by row.
    pub fn tiles(&self) -> impl Iterator<Item = (TileKey, Box<[Cell; TILE_CELLS]>)> {
        self.tiles.iter().map(|(key, cells)| (key, cells.cells()))
    }

    /// Whether nothing is in the map.
    pub fn is_empty(&self) -> bool {
        self.tiles.is_empty()
    }

    /// The smallest and the greatest cell index with evidence, both included.
    pub fn bounds(&self) -> Option<(CellIndex, CellIndex)> {
        let mut bounds: Option<(CellIndex, CellIndex)> = None;
        for (key, tile) in self.tiles.iter() {
            let ends = [key.cell(0), key.cell(TILE_CELLS - 1)];
            let is_inside = |cell: &CellIndex| {
                bounds.is_some_and(|(low, high)| {
                    (low.x..=high.x).contains(&cell.x) && (low.y..=high.y).contains(&cell.y)
                })
            };
            if ends.iter().all(is_inside) {
                continue;
            }
            for cell in tile.known().map(|(offset, _)| key.cell(offset)) {
                let (low, high) = bounds.get_or_insert((cell, cell));
                *low = CellIndex::new(low.x.min(cell.x), low.y.min(cell.y));
                *high = CellIndex::new(high.x.max(cell.x), high.y.max(cell.y));
            }
        }
        bounds
    }

    fn tile_mut(&mut self, key: TileKey) -> Result<&mut BlockTile, TooFar> {
        if self.tiles.get(key).is_none() {
            self.tiles.set(key, Box::default())?;
        }
        Ok(self.tiles.get_mut(key).expect("just set"))
    }
}

fn add(cells: &mut BlockTile, evidence: &[(u16, PackedCell)]) {
    for (place, evidence) in evidence {
        let place = usize::from(*place);
        cells.set_cell(place, cells.cell(place).combine(evidence.unpack()));
    }
}

/// Subtracts evidence as far as possible; gives the number of changed cells.
fn withdraw(cells: &mut BlockTile, evidence: &[(u16, PackedCell)]) -> usize {
    for (done, (place, evidence)) in evidence.iter().enumerate() {
        let place = usize::from(*place);
        match cells.cell(place).withdraw(evidence.unpack()) {
            Some(left) => cells.set_cell(place, left),
            None => return done,
        }
    }
    evidence.len()
}

impl PartialEq for FusedMap {
    fn eq(&self, other: &Self) -> bool {
        self.cell_size_m == other.cell_size_m && self.tiles().eq(other.tiles())
    }
}

/// The rectangle of a map that has evidence, as it is stored.
pub fn stored_map(map: &FusedMap) -> StoredMap {
    let MapShape { width, cell_size_m, origin, .. } = map.shape();
    let mut stored = StoredMap::of_width(width, cell_size_m, origin);
    let push = |row: &[Cell]| {
        stored.push_row(row);
        Ok::<(), std::convert::Infallible>(())
    };
    let Ok(()) = map.for_each_row(push);
    stored
}

impl FusedMap {
    /// Size and place of the rectangle that has evidence.
    pub fn shape(&self) -> MapShape {
        let Some((low, high)) = self.bounds() else { return MapShape::empty() };
        let cell_size_m = self.cell_size_m;
        MapShape {
            width: (high.x - low.x + 1) as usize,
            height: (high.y - low.y + 1) as usize,
            cell_size_m,
            origin: Point::new(f64::from(low.x) * cell_size_m, f64::from(low.y) * cell_size_m),
        }
    }

    /// Calls `visit` with each row of the rectangle that has evidence, the lowest y first.
    ///
    /// # Errors
    /// The first of `visit`, after which no row is visited.
    pub fn for_each_row<E>(&self, mut visit: impl FnMut(&[Cell]) -> Result<(), E>) -> Result<(), E> {
        let Some((low, high)) = self.bounds() else { return Ok(()) };
        let mut row = vec![Cell::UNKNOWN; (high.x - low.x + 1) as usize];
        for y in low.y..=high.y {
            let left = CellIndex::new(low.x, y);
            row.fill(Cell::UNKNOWN);
            for x in left.tile().x..=high.tile().x {
                let key = TileKey { x, y: left.tile().y };
                let Some(tile) = self.tiles.get(key) else { continue };
                let corner = key.cell(0);
                let (from, to) = (low.x.max(corner.x), high.x.min(corner.x + (TILE_SIDE - 1) as i32));
                let first = CellIndex::new(from, y).offset();
                let here = &mut row[(from - low.x) as usize..=(to - low.x) as usize];
                tile.copy_row(first / TILE_SIDE, first % TILE_SIDE, here);
            }
            visit(&row)?;
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use flockslam_evidence::SubmapTile;
    use proptest::prelude::*;

    fn of_tiles(tiles: Vec<SubmapTile>) -> Submap {
        Submap { number: 4, cell_size_m: 0.05, tiles, ..Submap::default() }
    }

    /// A submap with a few cells of evidence, a third of them cleared.
    pub(crate) fn submap() -> impl Strategy<Value = Submap> {
        let cells = proptest::collection::vec((-90i32..90, -90i32..90, 0u16..9000, 1u16..9000), 0..60);
        (cells, pose()).prop_map(|(cells, odom_from_submap)| {
            let mut submap = Submap { odom_from_submap, ..of_tiles(Vec::new()) };
            for (x, y, occupied, free) in cells {
                let cell = CellIndex::new(x, y);
                if submap.tile(cell.tile()).is_none() {
                    let unknown = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
                    submap.tiles.push(SubmapTile::new(cell.tile(), unknown));
                    submap.tiles.sort_by_key(|tile| tile.key);
                }
                let tile = submap.tile_mut(cell.tile()).unwrap();
                tile.cells[cell.offset()] = PackedCell { occupied, free };
                if occupied % 3 == 0 {
                    tile.clear(cell.offset());
                }
            }
            submap
        })
    }

    pub(crate) fn pose() -> impl Strategy<Value = Pose> {
        (-5.0..5.0f64, -5.0..5.0f64, -3.0..3.0f64).prop_map(|(x, y, heading)| Pose::new(x, y, heading))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_order_does_not_matter_and_withdrawal_is_exact(
            a in submap(), b in submap(), pose_a in pose(), pose_b in pose()
        ) {
            let (mut ab, mut ba, mut only_b) = (FusedMap::new(0.05), FusedMap::new(0.05), FusedMap::new(0.05));
            let footprint = ab.add(&a, pose_a).unwrap();
            for (key, cells) in ab.tiles() {
                let blocks = footprint.tiles().iter().find(|(of, _)| *of == key).map_or(0, |(_, blocks)| *blocks);
                for (place, _) in cells.iter().enumerate().filter(|(_, cell)| !cell.is_unknown()) {
                    prop_assert!(blocks >> (place / 512 * 8 + place % 64 / 8) & 1 == 1);
                }
            }
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
    fn a_submap_that_reaches_too_far_leaves_no_trace() {
        let cells = || Box::new([PackedCell { occupied: 5, free: 1 }; TILE_CELLS]);
        let tiles = [0, 1, 1 << 20].map(|x| SubmapTile::new(TileKey { x, y: 0 }, cells()));
        let near = of_tiles(tiles[1..2].to_vec());
        let far = Submap { tiles: tiles.to_vec(), ..near.clone() };
        let mut map = FusedMap::new(0.05);
        map.add(&near, Pose::IDENTITY).unwrap();
        let before = map.clone();
        assert!(map.add(&far, Pose::new(0.3, 0.2, 0.0)).is_err());
        assert_eq!(map, before);
    }

    #[test]
    fn what_is_not_in_the_map_cannot_be_taken_out() {
        let key = TileKey { x: 0, y: 0 };
        let mut tile = SubmapTile::new(key, Box::new([PackedCell { occupied: 5, free: 1 }; TILE_CELLS]));
        tile.clear(7);
        let mut submap = of_tiles(vec![tile]);
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
