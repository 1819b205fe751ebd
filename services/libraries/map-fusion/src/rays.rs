//! The cells that the beams of a scan cross, and the cells near their end points.

use crate::direction_set::DirectionSet;
use flockslam_evidence::{CellIndex, floor};
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{Deskew, ScanView};
use flockslam_ray_insertion::Ray;

/// Cells around the lidar, to each side.
const REACH_CELLS: i32 = 512;
const SIDE: usize = 2 * REACH_CELLS as usize;
/// Cells along the side of a block, a power of two.
pub const BLOCK_SIDE: i32 = 16;
/// Blocks along the side of the square; the lidar is in one, and half of another may stand out on either side.
const BLOCKS_SIDE: usize = SIDE / BLOCK_SIDE as usize + 1;

/// The cells of a square around the lidar; those farther away nothing crosses, and nothing ends near them.
#[derive(Debug)]
pub struct Rays {
    cell_size_m: f64,
    /// Beams are followed so far, metres …
    reach_m: f64,
    /// … and up to so far before their ends.
    before_m: f64,
    /// So many cells around an end are near it.
    near: i32,
    /// Cell of the lidar.
    middle: CellIndex,
    /// The number of the last scan of which a beam ended near, and of the last of which one went through; numbers begin again after 255.
    marks: Vec<Marks>,
    /// By block: the number of the last scan that has left a mark in it.
    blocks: Vec<u8>,
    scan: u8,
}

/// Of a cell, side by side, since both are read together.
#[derive(Clone, Copy, Debug, Default)]
struct Marks {
    ended: u8,
    crossed: u8,
}

impl Rays {
    /// Of no scan.
    pub fn new(cell_size_m: f64, reach_m: f64, before_m: f64, near: i32) -> Self {
        let (middle, marks) = (CellIndex::new(0, 0), vec![Marks::default(); SIDE * SIDE]);
        let blocks = vec![0; BLOCKS_SIDE * BLOCKS_SIDE];
        Self { cell_size_m, reach_m, before_m, near, middle, marks, blocks, scan: 0 }
    }

    /// Those of a scan from `at` that go where something is looked for, in place of those before.
    pub fn look(
        &mut self,
        scan: ScanView<'_>,
        deskew: &Deskew,
        map_from_base: Pose,
        at: Point,
        directions: &DirectionSet,
    ) {
        if self.scan == u8::MAX {
            self.marks.fill(Marks::default());
            self.blocks.fill(0);
            self.scan = 0;
        }
        self.scan += 1;
        self.middle = self.cell(at);
        let (sin, cos) = sin_cos(map_from_base.heading_rad);
        // As [`Pose::apply`], with the rotation worked out once.
        let in_map = |at: Point| {
            let (x_m, y_m) = (cos * at.x_m - sin * at.y_m, sin * at.x_m + cos * at.y_m);
            Point::new(x_m + map_from_base.x_m, y_m + map_from_base.y_m)
        };
        for beam in 0..scan.len() {
            let Some(range_m) = scan.valid_range_m(beam) else { continue };
            let end_at = deskew.ends_in_base(scan, beam);
            let free = in_map(end_at((range_m - self.before_m).clamp(0.0, self.reach_m)));
            let end = in_map(end_at(range_m));
            let is_wanted = |to: Point| directions.has(to.x_m - at.x_m, to.y_m - at.y_m);
            if !is_wanted(free) && !is_wanted(end) {
                continue;
            }
            self.cross(at, free);
            if range_m <= self.reach_m {
                self.end(self.cell(end));
            }
        }
    }

    fn cross(&mut self, from: Point, to: Point) {
        let in_cells = |at: Point| Point::new(at.x_m / self.cell_size_m, at.y_m / self.cell_size_m);
        let mut last = None;
        for cell in Ray::new(in_cells(from), in_cells(to)) {
            if let Some(place) = self.place(cell) {
                self.marks[place].crossed = self.scan;
                let block = Some(block_of(cell));
                if block != last {
                    last = block;
                    self.mark_block(cell);
                }
            }
        }
    }

    fn end(&mut self, end: CellIndex) {
        let around = -self.near..=self.near;
        for (dx, dy) in around.clone().flat_map(|dy| around.clone().map(move |dx| (dx, dy))) {
            let cell = CellIndex::new(end.x.saturating_add(dx), end.y.saturating_add(dy));
            if let Some(place) = self.place(cell) {
                self.marks[place].ended = self.scan;
            }
        }
        // What is near an end is less wide than a block.
        for (dx, dy) in [(-1, -1), (1, -1), (-1, 1), (1, 1)] {
            let (x, y) = (end.x.saturating_add(dx * self.near), end.y.saturating_add(dy * self.near));
            self.mark_block(CellIndex::new(x, y));
        }
    }

    fn mark_block(&mut self, cell: CellIndex) {
        if let Some(block) = self.block_place(block_of(cell)) {
            self.blocks[block] = self.scan;
        }
    }

    /// Whether a beam of the last scan may have crossed, or ended near, a cell of the block that holds this one.
    pub fn have_touched_block_of(&self, cell: CellIndex) -> bool {
        self.block_place(block_of(cell)).is_some_and(|block| self.blocks[block] == self.scan)
    }

    /// Whether a beam ends near a cell, and whether one goes through it and ends well behind it.
    #[inline]
    pub fn at(&self, cell: CellIndex) -> (bool, bool) {
        let marks = self.place(cell).map(|place| self.marks[place]);
        marks.map_or((false, false), |marks| (marks.ended == self.scan, marks.crossed == self.scan))
    }

    fn cell(&self, at: Point) -> CellIndex {
        CellIndex::new(floor(at.x_m / self.cell_size_m), floor(at.y_m / self.cell_size_m))
    }

    /// Every block with cells of the square has a place.
    fn block_place(&self, (x, y): (i32, i32)) -> Option<usize> {
        let middle = block_of(self.middle);
        let place = |index: i32, middle: i32| {
            let away = i64::from(index) - i64::from(middle) + i64::from(REACH_CELLS / BLOCK_SIDE);
            usize::try_from(away).ok().filter(|away| *away < BLOCKS_SIDE)
        };
        Some(place(y, middle.1)? * BLOCKS_SIDE + place(x, middle.0)?)
    }

    fn place(&self, cell: CellIndex) -> Option<usize> {
        let place = |index: i32, middle: i32| {
            let away = i64::from(index) - i64::from(middle) + i64::from(REACH_CELLS);
            usize::try_from(away).ok().filter(|away| *away < SIDE)
        };
        Some(place(cell.y, self.middle.y)? * SIDE + place(cell.x, self.middle.x)?)
    }
}

/// Column and row of the block of a cell.
#[inline]
fn block_of(cell: CellIndex) -> (i32, i32) {
    (cell.x.div_euclid(BLOCK_SIDE), cell.y.div_euclid(BLOCK_SIDE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Twist;
    use flockslam_messages::ScanBuffer;

    #[test]
    fn cells_are_crossed_or_near_the_ends_of_the_last_scan() {
        let mut rays = Rays::new(0.05, 12.0, 0.3, 2);
        let mut directions = DirectionSet::new();
        directions.add(Point::new(0.0, 0.0), Point::new(0.0, 0.0), 0.0);
        let mut look = |range_m: f32, at: Pose| {
            let scan = ScanBuffer::from_ranges(&[range_m, f32::INFINITY], 0.0, 0.1);
            let view = scan.view().unwrap();
            rays.look(view, &Deskew::new(view, Twist::default()), at, at.position(), &directions);
            [34, 35, 38, 39, 43, 44].map(|x| {
                let is = |y: i32| {
                    let cell = CellIndex::new(x, y);
                    let (near, crossed) = rays.at(cell);
                    assert!(rays.have_touched_block_of(cell) || !(near || crossed), "{cell:?}");
                    (near, crossed)
                };
                assert!(!is(1).1 && !is(3).0, "the beam goes along the lowest row");
                is(0)
            })
        };
        let at = Pose::new(0.01, 0.01, 0.0);
        let (none, crossed, near) = ((false, false), (false, true), (true, false));
        // The cell in which the free part of a beam ends is not crossed.
        assert_eq!(look(2.07, at), [crossed, none, none, near, near, none]);
        assert_eq!(look(4.0, at), [crossed; 6], "ends of the scan before are dropped");
        assert_eq!(look(1000.0, at), [crossed; 6]);
        assert_eq!(look(1002.06, Pose::new(-1000.0, 0.01, 0.0)), [none; 6], "too far from the lidar");
    }
}
