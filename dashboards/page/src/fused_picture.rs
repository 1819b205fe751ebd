//! The map of closed submaps on the page. It follows the solution one submap at a time.

use flockslam_evidence::{Submap, TILE_SIDE, TileKey, TooFar};
use flockslam_geometry::{Point, Pose};
use flockslam_map_fusion::{Footprint, FusedMap};
use std::collections::{BTreeMap, BTreeSet};

/// A submap is moved on the page once one of its corners is this many cells away from where the solution has it.
const MOVED_CELLS: f64 = 1.0;

/// The sum of closed submaps where the solution has them, kept up in small steps.
///
/// It keeps the stored bytes of each submap that is in it, so that it can be taken out again whatever has become of its file.
#[derive(Default)]
pub struct FusedPicture {
    map: Option<FusedMap>,
    placed: BTreeMap<u32, Placed>,
    changed: BTreeSet<TileKey>,
}

struct Placed {
    bytes: Vec<u8>,
    map_from_odom: Pose,
    footprint: Footprint,
    corners: [Point; 4],
    cell_size_m: f64,
}

impl FusedPicture {
    /// Whether a submap is in the picture.
    pub fn holds(&self, number: u32) -> bool {
        self.placed.contains_key(&number)
    }

    /// The submap that is to be brought to its place next: one that is missing or, else, the one farthest from its place.
    pub fn next_step(&self, submap_poses: &BTreeMap<u32, Pose>, stored: u32) -> Option<(u32, Pose)> {
        let wanted = submap_poses.iter().filter(|(number, _)| **number < stored);
        wanted
            .map(|(number, place)| (self.displacement_cells(*number, *place), (*number, *place)))
            .filter(|(cells, _)| *cells > MOVED_CELLS)
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, step)| step)
    }

    /// A submap in the picture that the solution has no place for.
    pub fn next_stray(&self, submap_poses: &BTreeMap<u32, Pose>) -> Option<u32> {
        self.placed.keys().copied().find(|number| !submap_poses.contains_key(number))
    }

    /// Brings a submap, given as it is stored, to its place. Bytes that are no submap leave it out.
    ///
    /// # Errors
    /// When its place is absurdly far from the others.
    pub fn place(&mut self, number: u32, bytes: Vec<u8>, map_from_odom: Pose) -> Result<(), TooFar> {
        self.remove(number);
        let Ok(submap) = Submap::decode(&bytes) else { return Ok(()) };
        let map = self.map.get_or_insert_with(|| FusedMap::new(submap.cell_size_m));
        let footprint = map.add(&submap, map_from_odom * submap.odom_from_submap)?;
        self.changed.extend(footprint.tiles().iter().map(|(key, _)| *key));
        let (corners, cell_size_m) = (corners(&submap), submap.cell_size_m);
        self.placed.insert(number, Placed { bytes, map_from_odom, footprint, corners, cell_size_m });
        Ok(())
    }

    /// Takes a submap out.
    pub fn remove(&mut self, number: u32) {
        let (Some(placed), Some(map)) = (self.placed.remove(&number), &mut self.map) else { return };
        let submap = Submap::decode(&placed.bytes).expect("it was decoded when it came in");
        map.withdraw(&submap, placed.map_from_odom * submap.odom_from_submap)
            .expect("it is taken out as it came in");
        self.changed.extend(placed.footprint.tiles().iter().map(|(key, _)| *key));
    }

    /// Takes note that a tile was looked at; `None` when none has changed since.
    pub fn next_changed(&mut self) -> Option<TileKey> {
        self.changed.pop_first()
    }

    /// The map; `None` before the first submap.
    pub fn map(&self) -> Option<&FusedMap> {
        self.map.as_ref()
    }

    /// How far a submap is from its place, cells; infinitely far when it is not in the picture.
    fn displacement_cells(&self, number: u32, place: Pose) -> f64 {
        self.placed.get(&number).map_or(f64::INFINITY, |placed| {
            let moved = |corner: &Point| placed.map_from_odom.apply(*corner).distance_m(place.apply(*corner));
            placed.corners.iter().map(moved).fold(0.0, f64::max) / placed.cell_size_m
        })
    }
}

/// Corners of the box around a submap's tiles, in odom; all at the origin when it has none.
fn corners(submap: &Submap) -> [Point; 4] {
    let side_m = submap.cell_size_m * TILE_SIDE as f64;
    let range = |pick: fn(&TileKey) -> i32| {
        let keys = || submap.tiles.iter().map(|tile| pick(&tile.key));
        let (low, high) = (keys().min().unwrap_or(0), keys().max().map_or(0, |high| high + 1));
        (f64::from(low) * side_m, f64::from(high) * side_m)
    };
    let ((left, right), (bottom, top)) = (range(|key| key.x), range(|key| key.y));
    [(left, bottom), (right, bottom), (left, top), (right, top)].map(|(x, y)| Point::new(x, y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{PackedCell, SubmapTile, TILE_CELLS};

    fn submap(number: u32) -> Submap {
        let cells = Box::new([PackedCell { occupied: 0, free: 900 }; TILE_CELLS]);
        Submap {
            number,
            odom_from_submap: Pose::new(1.0, 0.0, 0.2),
            cell_size_m: 0.05,
            tiles: vec![SubmapTile::new(TileKey { x: number as i32, y: 0 }, cells)],
            ..Submap::default()
        }
    }

    fn follow(picture: &mut FusedPicture, submap_poses: &BTreeMap<u32, Pose>) -> usize {
        let mut steps = 0;
        while let Some((number, place)) = picture.next_step(submap_poses, 9) {
            picture.place(number, submap(number).encode(), place).unwrap();
            steps += 1;
        }
        steps
    }

    #[test]
    fn submaps_come_move_and_go() {
        let mut picture = FusedPicture::default();
        let mut submap_poses: BTreeMap<_, _> = (0..3).map(|number| (number, Pose::IDENTITY)).collect();
        assert_eq!(picture.next_step(&submap_poses, 0), None, "none is stored");
        assert_eq!(follow(&mut picture, &submap_poses), 3);
        submap_poses.insert(1, Pose::new(0.04, 0.0, 0.0));
        assert_eq!(picture.next_step(&submap_poses, 9), None, "less than a cell");
        submap_poses.insert(1, Pose::new(0.0, 3.2, 0.0));
        while picture.next_changed().is_some() {}
        assert_eq!(follow(&mut picture, &submap_poses), 1);
        let changed: Vec<_> = std::iter::from_fn(|| picture.next_changed()).collect();
        assert!(changed.contains(&TileKey { x: 1, y: 0 }) && changed.contains(&TileKey { x: 1, y: 1 }));
        assert!(picture.map().unwrap().tile(TileKey { x: 1, y: 0 }).is_none());
        submap_poses.clear();
        while let Some(number) = picture.next_stray(&submap_poses) {
            picture.remove(number);
        }
        assert!(picture.map().unwrap().is_empty() && !picture.holds(0));
    }

    #[test]
    fn a_submap_without_evidence_and_foreign_bytes_are_borne() {
        let mut picture = FusedPicture::default();
        let empty = Submap { tiles: Vec::new(), ..submap(0) };
        picture.place(0, empty.encode(), Pose::new(5.0, 0.0, 1.0)).unwrap();
        picture.place(1, vec![1, 2, 3], Pose::IDENTITY).unwrap();
        assert!(picture.holds(0) && !picture.holds(1));
    }
}
