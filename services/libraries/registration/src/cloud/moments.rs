//! Points of several scans as integer moments in cells of 0.1 m, from which local lines are read.

use super::line_batch::LocalLine;
use super::{PackedPoint, Placement};
use flockslam_evidence::floor;
use zerocopy::FromZeros;

/// Units in a metre of the fixed-point coordinates: a quarter of a millimetre each.
const UNITS_PER_M: f64 = 4000.0;
/// Side of a cell in units: 0.1 m.
const CELL_UNITS: i32 = 400;
/// Cells along a side of the torus, a power of two: 102.4 m.
const SIDE: i32 = 1024;
/// Cells along the sides of a block. A block is stored in one piece, and only while it has points.
const BLOCK: (i32, i32) = (16, 8);
/// Cells of a block.
const BLOCK_CELLS: usize = (BLOCK.0 * BLOCK.1) as usize;
/// Blocks of the torus.
const BLOCKS: usize = (SIDE / BLOCK.0 * (SIDE / BLOCK.1)) as usize;
/// Columns and rows of cells whose lines are cached side by side, powers of two: 25.6 × 12.8 m.
const CACHED: (i32, i32) = (256, 128);
/// Fewest points from which a line is fitted.
const LINE_POINTS_MIN: i32 = 3;

/// Length of the direction in which a point is seen, as cells add it up.
const VIEW_UNITS: f64 = 256.0;

/// Zeroth, first and second moments of the points in a cell, about the cell's centre, in units, and the sum of the directions in
/// which they were seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Moments {
    count: i32,
    x: i32,
    y: i32,
    xx: i32,
    xy: i32,
    yy: i32,
    view_x: i32,
    view_y: i32,
}

/// A point of a scan at its place in a grid: what it adds to which cell. Whoever adds and withdraws the same points several times
/// places them once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlacedPoint {
    block: u16,
    place: u16,
    /// From the centre of its cell, in units.
    dx: i16,
    dy: i16,
    view_x: i16,
    view_y: i16,
}

impl PlacedPoint {
    /// A point of a scan that was taken at `at`.
    #[inline]
    pub fn new(at: &Placement, point: PackedPoint) -> Self {
        let (along_x, along_y) = at.rotate(point.x_m(), point.y_m());
        let (x, y) = (units(at.x_m + along_x), units(at.y_m + along_y));
        let view = VIEW_UNITS / (along_x * along_x + along_y * along_y).sqrt().max(1e-3);
        let (column, row) = (x.div_euclid(CELL_UNITS), y.div_euclid(CELL_UNITS));
        let (dx, dy) = (x - column * CELL_UNITS - CELL_UNITS / 2, y - row * CELL_UNITS - CELL_UNITS / 2);
        let (block, place) = index(column, row);
        // All are far below 2¹⁵: there are 8192 blocks of 128 cells, a cell has 400 units, and a direction 256.
        Self {
            block: block as u16,
            place: place as u16,
            dx: dx as i16,
            dy: dy as i16,
            view_x: (along_x * view) as i16,
            view_y: (along_y * view) as i16,
        }
    }
}

/// A block without points.
const EMPTY: [Moments; BLOCK_CELLS] =
    [Moments { count: 0, x: 0, y: 0, xx: 0, xy: 0, yy: 0, view_x: 0, view_y: 0 }; BLOCK_CELLS];

/// A fitted line is cached until the grid changes, or that of a cell further away takes its place.
#[derive(Clone, Copy, Default, FromZeros)]
struct CachedLine {
    version: u32,
    cell: u32,
    /// From the centre of this cell.
    line: LocalLine,
}

/// Points of a few scans as moments in cells of 0.1 m, from which local lines are read with sub-cell
/// accuracy.
///
/// Sums are integers: what is added can be withdrawn again, exactly, in any order. The cells lie on a torus
/// of 102 m, so the grid follows the robot without being moved; all points held at one time must fit on it.
/// Blocks of cells without points take no memory: it is used again for those that the robot comes to.
pub struct MomentGrid {
    /// By block of the torus: where its cells are stored; 0 while it has no points.
    places: Vec<u16>,
    /// The stored blocks. Those at place 0 stay empty: they stand for all blocks without points.
    stored: Vec<[Moments; BLOCK_CELLS]>,
    /// By place: number of points in the block.
    points: Vec<i32>,
    /// Places that are not in use; all their cells are empty.
    unused: Vec<u16>,
    lines: Vec<CachedLine>,
    version: u32,
}

impl Default for MomentGrid {
    fn default() -> Self {
        // Zeroed memory takes no room before it is written to.
        let no_memory = "there is memory for a megabyte";
        Self {
            places: vec![0; BLOCKS],
            stored: vec![EMPTY],
            points: vec![0],
            unused: Vec::new(),
            lines: CachedLine::new_vec_zeroed((CACHED.0 * CACHED.1) as usize).expect(no_memory),
            version: 1,
        }
    }
}

impl MomentGrid {
    /// Distance between two points beyond which they could share a cell of the torus, metres.
    pub const SPAN_M: f64 = (SIDE * CELL_UNITS) as f64 / UNITS_PER_M;
    /// Side of a cell, metres.
    pub const CELL_M: f64 = CELL_UNITS as f64 / UNITS_PER_M;

    /// Adds a scan's points, seen from `at`.
    pub fn add(&mut self, at: &Placement, points: &[PackedPoint]) {
        self.version += 1;
        points.iter().for_each(|point| self.change(PlacedPoint::new(at, *point), 1));
    }

    /// Subtracts what [`Self::add`] with the same arguments has added.
    pub fn withdraw(&mut self, at: &Placement, points: &[PackedPoint]) {
        self.version += 1;
        points.iter().for_each(|point| self.change(PlacedPoint::new(at, *point), -1));
    }

    /// Adds points that are placed already.
    pub fn add_placed(&mut self, points: &[PlacedPoint]) {
        self.version += 1;
        points.iter().for_each(|point| self.change(*point, 1));
    }

    /// Subtracts what [`Self::add_placed`] has added.
    pub fn withdraw_placed(&mut self, points: &[PlacedPoint]) {
        self.version += 1;
        points.iter().for_each(|point| self.change(*point, -1));
    }

    #[inline]
    fn change(&mut self, point: PlacedPoint, sign: i32) {
        let (dx, dy) = (i32::from(point.dx), i32::from(point.dy));
        let block = usize::from(point.block);
        let stored = self.store_for(block, sign);
        let cell = &mut self.stored[stored][usize::from(point.place)];
        cell.count += sign;
        cell.x += sign * dx;
        cell.y += sign * dy;
        cell.xx += sign * dx * dx;
        cell.xy += sign * dx * dy;
        cell.yy += sign * dy * dy;
        cell.view_x += sign * i32::from(point.view_x);
        cell.view_y += sign * i32::from(point.view_y);
        if self.points[stored] == 0 {
            debug_assert!(self.stored[stored] == EMPTY, "what is withdrawn was added");
            self.places[block] = 0;
            self.unused.push(stored as u16);
        }
    }

    /// Where a block is stored that gets or loses a point.
    #[inline]
    fn store_for(&mut self, block: usize, change: i32) -> usize {
        if self.places[block] == 0 {
            self.places[block] = self.place_for_another();
        }
        let stored = usize::from(self.places[block]);
        self.points[stored] += change;
        stored
    }

    #[cold]
    fn place_for_another(&mut self) -> u16 {
        self.unused.pop().unwrap_or_else(|| {
            self.stored.push(EMPTY);
            self.points.push(0);
            (self.stored.len() - 1) as u16
        })
    }

    #[inline]
    fn cell(&self, column: i32, row: i32) -> &Moments {
        let (block, place) = index(column, row);
        &self.stored[usize::from(self.places[block])][place]
    }

    /// Number of points in the cell that holds (x, y) metres.
    pub fn count_at(&self, x_m: f64, y_m: f64) -> i32 {
        self.cell(units(x_m).div_euclid(CELL_UNITS), units(y_m).div_euclid(CELL_UNITS)).count
    }

    /// The line that belongs to the point (dx, dy) metres from the centre of a cell: that of its own cell, else of the nearest occupied
    /// cell among the eight around it; without any, one that is not flat.
    #[inline]
    pub(super) fn local_line(&mut self, column: i32, row: i32, dx_m: f32, dy_m: f32) -> LocalLine {
        let cached = self.lines[slot(column, row)];
        // Only lines of occupied cells are cached.
        if (cached.version, cached.cell) == (self.version, number(column, row)) {
            cached.line
        } else {
            self.other_local_line(column, row, dx_m, dy_m)
        }
    }

    /// As [`Self::local_line`], where the line of the point's own cell is not cached.
    fn other_local_line(&mut self, column: i32, row: i32, dx_m: f32, dy_m: f32) -> LocalLine {
        if self.cell(column, row).count > 0 {
            return self.line_of(column, row);
        }
        let in_cell = |offset_m: f32| (offset_m * UNITS_PER_M as f32) as i32;
        let Some((along, up)) = self.nearest_occupied(column, row, in_cell(dx_m), in_cell(dy_m)) else {
            return LocalLine::default();
        };
        let mut line = self.line_of(column + along, row + up);
        line.x_m += along as f32 * Self::CELL_M as f32;
        line.y_m += up as f32 * Self::CELL_M as f32;
        line
    }

    /// The nearest occupied cell around one, as columns and rows from it, for a point so many units from its centre.
    fn nearest_occupied(&self, column: i32, row: i32, x: i32, y: i32) -> Option<(i32, i32)> {
        let mut nearest = None;
        let mut least = i32::MAX;
        for up in -1..=1 {
            for along in -1..=1 {
                let cell = self.cell(column + along, row + up);
                if cell.count > 0 {
                    let dx = x - along * CELL_UNITS - cell.x / cell.count;
                    let dy = y - up * CELL_UNITS - cell.y / cell.count;
                    let squared = dx * dx + dy * dy;
                    if squared < least {
                        (least, nearest) = (squared, Some((along, up)));
                    }
                }
            }
        }
        nearest
    }

    fn line_of(&mut self, column: i32, row: i32) -> LocalLine {
        let slot = slot(column, row);
        let cell = number(column, row);
        if (self.lines[slot].version, self.lines[slot].cell) != (self.version, cell) {
            self.lines[slot] = CachedLine { version: self.version, cell, line: self.fit(column, row) };
        }
        self.lines[slot].line
    }

    /// Fits a line to the points of a cell and its eight neighbours: the direction comes from all of them,
    /// the anchor from the cell itself.
    fn fit(&self, column: i32, row: i32) -> LocalLine {
        let (mut n, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0i64, 0i64, 0i64, 0i64, 0i64, 0i64);
        for r in -1..=1i32 {
            for c in -1..=1i32 {
                let cell = self.cell(column + c, row + r);
                let count = i64::from(cell.count);
                let (ox, oy) = (i64::from(c * CELL_UNITS), i64::from(r * CELL_UNITS));
                let (x, y) = (i64::from(cell.x), i64::from(cell.y));
                n += count;
                sx += x + count * ox;
                sy += y + count * oy;
                sxx += i64::from(cell.xx) + 2 * ox * x + count * ox * ox;
                sxy += i64::from(cell.xy) + ox * y + oy * x + count * ox * oy;
                syy += i64::from(cell.yy) + 2 * oy * y + count * oy * oy;
            }
        }
        let own = self.cell(column, row);
        let mut line = LocalLine::default();
        if n < i64::from(LINE_POINTS_MIN) || own.count == 0 {
            return line;
        }
        let inverse = 1.0 / n as f64;
        let (mx, my) = (sx as f64 * inverse, sy as f64 * inverse);
        let (a, b, d) =
            (sxx as f64 * inverse - mx * mx, sxy as f64 * inverse - mx * my, syy as f64 * inverse - my * my);
        let half_gap = (0.25 * (a - d) * (a - d) + b * b).sqrt();
        let middle = 0.5 * (a + d);
        if half_gap <= 0.0 || middle <= 0.0 {
            return line;
        }
        // Eigenvector of the larger eigenvalue, from whichever row of (C - λI) is better conditioned.
        let along = if a >= d { (half_gap + 0.5 * (a - d), b) } else { (b, half_gap + 0.5 * (d - a)) };
        let length = (along.0 * along.0 + along.1 * along.1).sqrt();
        let (normal_x, normal_y) = (-along.1 / length, along.0 / length);
        let views = f64::from(own.count) * VIEW_UNITS;
        let away = (normal_x * f64::from(own.view_x) + normal_y * f64::from(own.view_y)) / views;
        let towards_lidar = if away > 0.0 { -1.0 } else { 1.0 };
        (line.normal_x, line.normal_y) =
            ((towards_lidar * normal_x) as f32, (towards_lidar * normal_y) as f32);
        line.facing = away.abs() as f32;
        line.flatness = (half_gap / middle) as f32;
        let own_inverse = 1.0 / (f64::from(own.count) * UNITS_PER_M);
        line.x_m = (f64::from(own.x) * own_inverse) as f32;
        line.y_m = (f64::from(own.y) * own_inverse) as f32;
        line
    }
}

#[inline]
fn units(metres: f64) -> i32 {
    // Half a million metres away all cells are one; nothing overflows.
    floor((metres * UNITS_PER_M).clamp(-2e9, 2e9))
}

/// The block of a cell on the torus, and the cell's place in it.
#[inline]
fn index(column: i32, row: i32) -> (usize, usize) {
    let (column, row) = (column & (SIDE - 1), row & (SIDE - 1));
    let block = row / BLOCK.1 * (SIDE / BLOCK.0) + column / BLOCK.0;
    (block as usize, (row % BLOCK.1 * BLOCK.0 + column % BLOCK.0) as usize)
}

/// Where the line of a cell is cached.
#[inline]
fn slot(column: i32, row: i32) -> usize {
    ((row & (CACHED.1 - 1)) * CACHED.0 + (column & (CACHED.0 - 1))) as usize
}

/// The number of a cell of the torus.
#[inline]
fn number(column: i32, row: i32) -> u32 {
    ((row & (SIDE - 1)) * SIDE + (column & (SIDE - 1))) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn wall() -> Vec<PackedPoint> {
        // y = 2 + x/2, from x = -1 to 3 m.
        (0..200)
            .map(|i| f64::from(i) * 0.02 - 1.0)
            .filter_map(|x| PackedPoint::from_metres(x, 2.0 + 0.5 * x))
            .collect()
    }

    /// The line near a point, from the centre of its cell; and the point from there.
    fn line_near(grid: &mut MomentGrid, x_m: f64, y_m: f64) -> Option<(LocalLine, (f32, f32))> {
        let cell = |m: f64| (m / MomentGrid::CELL_M).floor();
        let offset_m = |m: f64| (m - (cell(m) + 0.5) * MomentGrid::CELL_M) as f32;
        let (dx, dy) = (offset_m(x_m), offset_m(y_m));
        let line = grid.local_line(cell(x_m) as i32, cell(y_m) as i32, dx, dy);
        (line.flatness > 0.0).then_some((line, (dx, dy)))
    }

    /// All cells of the torus by their places.
    fn cells(grid: &MomentGrid) -> Vec<Moments> {
        grid.places.iter().flat_map(|place| grid.stored[usize::from(*place)]).collect()
    }

    #[test]
    fn memory_is_used_again_when_the_grid_follows_a_robot() {
        let mut grid = MomentGrid::default();
        let at = |k: i32| Placement::new(0.7 * f64::from(k), 0.3 * f64::from(k), 0.1 * f64::from(k));
        for k in 0..400 {
            grid.add(&at(k), &wall());
            if k >= 20 {
                grid.withdraw(&at(k - 20), &wall());
            }
        }
        // A wall of 4.5 m is in a few blocks; 21 walls were held at one time.
        assert!(grid.stored.len() < 21 * 8, "{}", grid.stored.len());
        (380..400).for_each(|k| grid.withdraw(&at(k), &wall()));
        assert!(grid.places.iter().all(|place| *place == 0));
    }

    #[test]
    fn reads_a_wall_with_sub_cell_accuracy() {
        let mut grid = MomentGrid::default();
        grid.add(&Placement::IDENTITY, &wall());
        for x in [-0.5, 0.03, 1.111, 2.5] {
            let (line, (dx, dy)) = line_near(&mut grid, x, 2.0 + 0.5 * x).unwrap();
            let distance = line.normal_x * (dx - line.x_m) + line.normal_y * (dy - line.y_m);
            assert!(distance.abs() < 0.002, "{distance}");
            assert!((line.normal_x / line.normal_y + 0.5).abs() < 0.02 && line.flatness > 0.95, "{line:?}");
        }
        assert!(line_near(&mut grid, 0.0, 4.0).is_none());
    }

    #[test]
    fn every_cell_of_the_torus_has_a_place_of_its_own() {
        let mut taken = vec![false; (SIDE * SIDE) as usize];
        for (row, column) in (-3..SIDE - 3).flat_map(|row| (5..SIDE + 5).map(move |column| (row, column))) {
            let (block, place) = index(column, row);
            let taken = &mut taken[block * BLOCK_CELLS + place];
            assert!(!std::mem::replace(taken, true), "{column} {row}");
        }
    }

    #[test]
    fn cells_that_share_a_place_for_lines_do_not_take_each_others() {
        let mut grid = MomentGrid::default();
        let apart_m = f64::from(CACHED.0) * MomentGrid::CELL_M;
        let turned = Placement::new(apart_m, 0.0, 0.3);
        grid.add(&Placement::IDENTITY, &wall());
        grid.add(&turned, &wall());
        let near = line_near(&mut grid, 0.03, 2.015).unwrap();
        for x in [-0.5, 0.03, 1.111, 2.5] {
            let (x_m, y_m) = turned.apply(x, 2.0 + 0.5 * x);
            line_near(&mut grid, x_m, y_m).unwrap();
            assert_eq!(line_near(&mut grid, 0.03, 2.015).unwrap(), near);
        }
    }

    proptest! {
        #[test]
        fn what_is_withdrawn_leaves_no_trace(x in -40.0..40.0f64, y in -40.0..40.0f64, heading in -3.0..3.0f64) {
            let mut grid = MomentGrid::default();
            grid.add(&Placement::IDENTITY, &wall());
            let before = cells(&grid);
            let line = line_near(&mut grid, 0.03, 2.015);
            let elsewhere = Placement::new(x, y, heading);
            grid.add(&elsewhere, &wall());
            grid.withdraw(&elsewhere, &wall());
            prop_assert!(before == cells(&grid));
            prop_assert!(line.is_some());
            prop_assert_eq!(line, line_near(&mut grid, 0.03, 2.015));
        }
    }
}
