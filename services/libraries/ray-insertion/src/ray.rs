//! Rays through the lattice: origin and end in, the cells between them out, in fixed-point arithmetic with one cell for
//! each step along the longer axis.

use crate::CrossedCells;
use flockslam_evidence::{CellIndex, TILE_SIDE, TileKey, floor};
use flockslam_geometry::Point;

/// Cells that a ray may cross along its longer axis: a bound on the work that a damaged input can ask for.
const STEPS_MAX: i32 = 1 << 16;
/// Binary digits behind the point of the fixed-point arithmetic along the shorter axis.
const FRACTION: u32 = 32;

/// The cells that a ray crosses before its end, one per column (or row, when it is steep), from `origin` on.
///
/// `origin` and `end` count cells (metres divided by the cell's side). The cell of the end itself is left out.
#[derive(Clone, Debug)]
pub struct Ray {
    cell: i32,
    step: i32,
    left: i32,
    cross: i64,
    slope: i64,
    cross_origin: i32,
    steep: bool,
}

impl Ray {
    /// The ray between two points, both in units of cells.
    pub fn new(origin: Point, end: Point) -> Self {
        let (dx, dy) = (end.x_m - origin.x_m, end.y_m - origin.y_m);
        let steep = dy.abs() > dx.abs();
        let (from, to, across, length, rise) = if steep {
            (origin.y_m, end.y_m, origin.x_m, dy, dx)
        } else {
            (origin.x_m, end.x_m, origin.y_m, dx, dy)
        };
        let (first, last) = (floor(from), floor(to));
        let slope = if length == 0.0 { 0.0 } else { rise / length.abs() };
        let cross_origin = floor(across);
        // Distance along the longer axis from the origin to the middle of its own cell.
        let to_middle = (f64::from(first) + 0.5 - from) * length.signum();
        let fixed = |cells: f64| (cells * (1u64 << FRACTION) as f64) as i64;
        Self {
            cell: first,
            step: if last < first { -1 } else { 1 },
            left: last.saturating_sub(first).saturating_abs().min(STEPS_MAX),
            cross: fixed(across - f64::from(cross_origin) + slope * to_middle),
            slope: fixed(slope),
            cross_origin,
            steep,
        }
    }
}

impl Ray {
    /// The tile of the next cell; `None` at the ray's end.
    #[inline]
    pub fn tile(&self) -> Option<TileKey> {
        (self.left > 0).then(|| self.place().tile())
    }

    /// Marks the cells of the next cell's tile, and goes on after it.
    ///
    /// It does what marking cell by cell would do, but along a tile's longer axis there is nothing to decide.
    #[inline]
    pub fn cross_tile(&mut self, crossed: &mut CrossedCells) {
        let (first, side) = (self.place(), TILE_SIDE as i32);
        let (along, across) = if self.steep { (first.y, first.x) } else { (first.x, first.y) };
        let to_edge = if self.step > 0 { side - (along & (side - 1)) } else { (along & (side - 1)) + 1 };
        let words = crossed.words(self.steep);
        let edge = across & !(side - 1);
        for _ in 0..to_edge.min(self.left) {
            let across = self.across().wrapping_sub(edge) as u32;
            if across >= side as u32 {
                break;
            }
            words[(self.cell & (side - 1)) as usize] |= 1 << across;
            self.go_on();
        }
    }

    #[inline]
    fn across(&self) -> i32 {
        self.cross_origin.wrapping_add((self.cross >> FRACTION) as i32)
    }

    #[inline]
    fn place(&self) -> CellIndex {
        if self.steep {
            CellIndex::new(self.across(), self.cell)
        } else {
            CellIndex::new(self.cell, self.across())
        }
    }

    #[inline]
    fn go_on(&mut self) {
        self.left = self.left.wrapping_sub(1);
        self.cell = self.cell.wrapping_add(self.step);
        self.cross = self.cross.wrapping_add(self.slope);
    }
}

impl Iterator for Ray {
    type Item = CellIndex;

    #[inline]
    fn next(&mut self) -> Option<CellIndex> {
        if self.left == 0 {
            return None;
        }
        let cell = self.place();
        self.go_on();
        Some(cell)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn every_cell_lies_on_the_segment_and_neighbours_touch(
            ox in -50.0..50.0f64, oy in -50.0..50.0f64, dx in -80.0..80.0f64, dy in -80.0..80.0f64
        ) {
            let (origin, end) = (Point::new(ox, oy), Point::new(ox + dx, oy + dy));
            let last = CellIndex::new(floor(end.x_m), floor(end.y_m));
            let length = dx.hypot(dy);
            // One cell for each column, or row when the ray is steep, without that of the end.
            let steep = (end.y_m - origin.y_m).abs() > (end.x_m - origin.x_m).abs();
            let columns = if steep { last.y.abs_diff(floor(oy)) } else { last.x.abs_diff(floor(ox)) };
            prop_assert_eq!(Ray::new(origin, end).count(), columns as usize);
            let mut before: Option<CellIndex> = None;
            for cell in Ray::new(origin, end) {
                let (cx, cy) = (f64::from(cell.x) + 0.5 - ox, f64::from(cell.y) + 0.5 - oy);
                prop_assert!((cx * dy - cy * dx).abs() / length <= 0.5 + 1e-6, "{:?} is off the line", cell);
                prop_assert_ne!(cell, last);
                if let Some(b) = before {
                    prop_assert!((cell.x - b.x).abs() <= 1 && (cell.y - b.y).abs() <= 1);
                }
                before = Some(cell);
            }
            // The ray ends somewhere in its last column, up to one and a half columns from the middle of the one before.
            if let Some(b) = before {
                prop_assert!((last.x - b.x).abs() <= 2 && (last.y - b.y).abs() <= 2);
            }
        }
    }

    proptest! {
        #[test]
        fn crossing_tile_by_tile_marks_the_same_cells(
            ox in -100.0..100.0f64, oy in -100.0..100.0f64, dx in -300.0..300.0f64, dy in -300.0..300.0f64
        ) {
            let ray = Ray::new(Point::new(ox, oy), Point::new(ox + dx, oy + dy));
            let mut tiles: BTreeMap<TileKey, CrossedCells> = BTreeMap::new();
            let mut walked = ray.clone();
            while let Some(key) = walked.tile() {
                walked.cross_tile(tiles.entry(key).or_default());
            }
            let mut marked = Vec::new();
            for (key, mut crossed) in tiles {
                for (y, row) in crossed.take().into_iter().enumerate() {
                    let bits = (0..TILE_SIDE).filter(|x| row >> x & 1 == 1);
                    marked.extend(bits.map(|x| key.cell(y * TILE_SIDE + x)));
                }
                prop_assert_eq!(crossed.take(), [0; TILE_SIDE]);
            }
            let mut cells: Vec<CellIndex> = ray.collect();
            cells.sort_unstable();
            marked.sort_unstable();
            prop_assert_eq!(marked, cells);
        }
    }

    #[test]
    fn absurd_ends_take_bounded_work() {
        let origin = Point::new(0.0, 0.0);
        for (end, cells) in [
            (Point::new(1e300, 3.0), STEPS_MAX),
            (Point::new(f64::NAN, f64::NAN), 0),
            (Point::new(f64::NEG_INFINITY, 0.0), STEPS_MAX),
        ] {
            assert_eq!(Ray::new(origin, end).count(), cells as usize, "{end:?}");
        }
    }
}
