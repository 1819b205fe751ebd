//! The surfaces of the known map as lines: in each cell of a decimetre the line of what is occupied beside free space, one for each side of a
//! thin wall.

use crate::KnownMap;
use flockslam_evidence::{CellState, floor};
use flockslam_geometry::Point;
use flockslam_geometry::elementary::{atan2, hypot, sin_cos};

/// Cells of lines are about this wide, metres.
const CELL_M: f64 = 0.1;
/// Sides of a block of cells that is stored together.
const BLOCK: usize = 8;
/// An occupied cell belongs to a surface when free space is within so many cells.
const BESIDE: i64 = 1;
/// A line is fitted to the cells of its surface within this, metres.
const FIT_M: f64 = 0.2;
/// Cells of one surface look the same way: least cosine.
const SAME_SIDE: f64 = 0.3;
/// Free space on one side only: least length of the mean direction to it.
const SIDED: f64 = 0.3;

/// A line of a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SurfaceLine {
    /// A point on it in the map frame, metres.
    pub x_m: f32,
    pub y_m: f32,
    /// Unit normal. With sides it points to the free space before the surface.
    pub normal_x: f32,
    pub normal_y: f32,
    /// 0 for a round blob … 1 for a thin line.
    pub flatness: f32,
    /// Whether free space is on one side only.
    pub has_sides: bool,
}

/// The lines of a map.
pub struct SurfaceLines {
    cell_m: f64,
    origin: Point,
    /// Blocks along x, and along y.
    blocks: (usize, usize),
    /// By block: one more than where it is stored; 0 when it has no line.
    places: Vec<u32>,
    /// By cell of a stored block: first and end of its lines.
    stored: Vec<[(u32, u8); BLOCK * BLOCK]>,
    lines: Vec<SurfaceLine>,
}

/// An occupied cell beside free space: its column, its middle, and the mean direction to free space with its length.
#[derive(Clone, Copy)]
struct SurfaceCell {
    column: i64,
    x_m: f64,
    y_m: f64,
    to_free: (f64, f64),
    sided: f64,
}

/// The occupied cells that are not deep in a wall, by row and column.
struct SurfaceCells {
    cells: Vec<SurfaceCell>,
    /// Of each row the first of its cells; the end of the last one.
    rows: Vec<usize>,
}

impl SurfaceLines {
    /// The lines of a map.
    pub fn new(map: &KnownMap) -> Self {
        let cells = (CELL_M / map.cell_size_m()).round().max(1.0) as i64;
        let surface = SurfaceCells::of(map);
        let per_block = cells as usize * BLOCK;
        let blocks = (map.width().div_ceil(per_block).max(1), map.height().div_ceil(per_block).max(1));
        let mut lines = Self {
            cell_m: map.cell_size_m() * cells as f64,
            origin: map.origin(),
            blocks,
            places: vec![0; blocks.0 * blocks.1],
            stored: Vec::new(),
            lines: Vec::new(),
        };
        let reach = (FIT_M / map.cell_size_m()).floor() as i64;
        for row in 0..map.height().div_ceil(cells as usize) {
            let mut of_row = surface.of_rows(row * cells as usize, cells as usize).to_vec();
            of_row.sort_by_key(|cell| cell.column / cells);
            for of_cell in of_row.chunk_by(|a, b| a.column / cells == b.column / cells) {
                let first = lines.lines.len() as u32;
                let mut sides: Vec<SurfaceCell> = Vec::new();
                for cell in of_cell {
                    // The first of each side stands for it.
                    if sides.len() < 2 && sides.iter().all(|side| !is_same_side(side, cell)) {
                        sides.push(*cell);
                    }
                }
                lines.lines.extend(sides.iter().map(|side| fitted(map, &surface, side, reach)));
                lines.put((of_cell[0].column / cells) as usize, row, (first, sides.len() as u8));
            }
        }
        lines
    }

    fn put(&mut self, column: usize, row: usize, lines: (u32, u8)) {
        let block = row / BLOCK * self.blocks.0 + column / BLOCK;
        if self.places[block] == 0 {
            self.stored.push([(0, 0); BLOCK * BLOCK]);
            self.places[block] = self.stored.len() as u32;
        }
        self.stored[self.places[block] as usize - 1][row % BLOCK * BLOCK + column % BLOCK] = lines;
    }

    fn of_cell(&self, column: i64, row: i64) -> &[SurfaceLine] {
        let (Ok(column), Ok(row)) = (usize::try_from(column), usize::try_from(row)) else { return &[] };
        let block = (column / BLOCK, row / BLOCK);
        if block.0 >= self.blocks.0 || block.1 >= self.blocks.1 {
            return &[];
        }
        match self.places[block.1 * self.blocks.0 + block.0] {
            0 => &[],
            place => {
                let (first, count) = self.stored[place as usize - 1][row % BLOCK * BLOCK + column % BLOCK];
                &self.lines[first as usize..first as usize + usize::from(count)]
            }
        }
    }

    /// The line nearest to a point of the map frame that is seen along `view`, among the lines of its cell and of those around it.
    #[inline]
    pub(crate) fn near(&self, x_m: f64, y_m: f64, view: (f64, f64)) -> Option<SurfaceLine> {
        let column = i64::from(floor((x_m - self.origin.x_m) / self.cell_m));
        let row = i64::from(floor((y_m - self.origin.y_m) / self.cell_m));
        let (mut nearest, mut least) = (None, f64::INFINITY);
        for (c, r) in (row - 1..=row + 1).flat_map(|r| (column - 1..=column + 1).map(move |c| (c, r))) {
            for line in self.of_cell(c, r) {
                let (dx, dy) = (x_m - f64::from(line.x_m), y_m - f64::from(line.y_m));
                let squared = dx * dx + dy * dy;
                let along = f64::from(line.normal_x) * view.0 + f64::from(line.normal_y) * view.1;
                if squared < least && !(line.has_sides && along > 0.0) {
                    (least, nearest) = (squared, Some(*line));
                }
            }
        }
        nearest
    }
}

fn is_same_side(a: &SurfaceCell, b: &SurfaceCell) -> bool {
    a.to_free.0 * b.to_free.0 + a.to_free.1 * b.to_free.1 > SAME_SIDE * (a.sided * b.sided).max(SIDED * SIDED)
}

impl SurfaceCells {
    fn of(map: &KnownMap) -> Self {
        let mut surface = Self { cells: Vec::new(), rows: Vec::with_capacity(map.height() + 1) };
        for row in 0..map.height() {
            surface.rows.push(surface.cells.len());
            let cells = map.occupied_columns(row);
            surface.cells.extend(cells.filter_map(|column| surface_cell(map, column as i64, row as i64)));
        }
        surface.rows.push(surface.cells.len());
        surface
    }

    /// The cells of so many rows from one on.
    fn of_rows(&self, first: usize, count: usize) -> &[SurfaceCell] {
        let row = |row: usize| self.rows[row.min(self.rows.len() - 1)];
        &self.cells[row(first)..row(first + count)]
    }

    /// The cells of a row from the one column to the other.
    fn within(&self, row: i64, first: i64, last: i64) -> &[SurfaceCell] {
        let Ok(row) = usize::try_from(row) else { return &[] };
        let cells = self.of_rows(row, 1);
        let begin = cells.partition_point(|cell| cell.column < first);
        let count = cells[begin..].iter().take_while(|cell| cell.column <= last).count();
        &cells[begin..begin + count]
    }
}

/// An occupied cell, unless it lies deep in a wall.
fn surface_cell(map: &KnownMap, column: i64, row: i64) -> Option<SurfaceCell> {
    let (mut x, mut y, mut free) = (0.0, 0.0, 0.0);
    for (dx, dy) in (-BESIDE..=BESIDE).flat_map(|dy| (-BESIDE..=BESIDE).map(move |dx| (dx, dy))) {
        if map.cell(column + dx, row + dy).state == CellState::Free {
            let share = 1.0 / hypot(dx as f64, dy as f64);
            (x, y, free) = (x + dx as f64 * share, y + dy as f64 * share, free + 1.0);
        }
    }
    if free == 0.0 {
        return None;
    }
    let (x_m, y_m) = map.middle(column, row);
    let to_free = (x / free, y / free);
    Some(SurfaceCell { column, x_m, y_m, to_free, sided: hypot(to_free.0, to_free.1) })
}

/// The line of a surface around one of its cells.
fn fitted(map: &KnownMap, surface: &SurfaceCells, at: &SurfaceCell, reach: i64) -> SurfaceLine {
    let (column, row) = (map.column(at.x_m), map.row(at.y_m));
    let (mut n, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let (mut near, mut near_x, mut near_y) = (0.0, 0.0, 0.0);
    for r in row - reach..=row + reach {
        let in_row = surface.within(r, column - reach, column + reach);
        for other in in_row.iter().filter(|other| is_same_side(at, other)) {
            let (dx, dy) = (other.x_m - at.x_m, other.y_m - at.y_m);
            (n, sx, sy) = (n + 1.0, sx + dx, sy + dy);
            (sxx, sxy, syy) = (sxx + dx * dx, sxy + dx * dy, syy + dy * dy);
            if dx * dx + dy * dy <= CELL_M * CELL_M {
                (near, near_x, near_y) = (near + 1.0, near_x + dx, near_y + dy);
            }
        }
    }
    let has_sides = at.sided > SIDED;
    let mut line = SurfaceLine { has_sides, ..SurfaceLine::default() };
    if n < 1.0 {
        (line.x_m, line.y_m) = (at.x_m as f32, at.y_m as f32);
        return line;
    }
    let (mx, my) = (sx / n, sy / n);
    let (vxx, vxy, vyy) = (sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my);
    // Eigenvalues of the covariance; the normal belongs to the smaller one.
    let (middle, spread) = (0.5 * (vxx + vyy), hypot(0.5 * (vxx - vyy), vxy));
    let angle = 0.5 * atan2(2.0 * vxy, vxx - vyy);
    let (sin, cos) = sin_cos(angle);
    let (mut normal_x, mut normal_y) = (-sin, cos);
    if normal_x * at.to_free.0 + normal_y * at.to_free.1 < 0.0 {
        (normal_x, normal_y) = (-normal_x, -normal_y);
    }
    // The line passes the mean of what is near.
    (line.x_m, line.y_m) = ((at.x_m + near_x / near) as f32, (at.y_m + near_y / near) as f32);
    (line.normal_x, line.normal_y) = (normal_x as f32, normal_y as f32);
    line.flatness = if n >= 3.0 && middle > 0.0 { (spread / middle) as f32 } else { 0.0 };
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of two cells from left to right with free space on both sides, and a solid block above.
    fn map() -> KnownMap {
        let mut map = KnownMap::of_width(60, 0.05, Point::default());
        for y in 0..40 {
            let state = match y {
                20 | 21 | 32.. => CellState::Occupied,
                _ => CellState::Free,
            };
            map.push_row((0..60).map(|_| state));
        }
        map.measured()
    }

    #[test]
    fn a_wall_has_a_line_that_looks_into_the_free_space_before_it() {
        let lines = SurfaceLines::new(&map());
        let block = lines.near(1.5, 1.62, (0.0, 1.0)).unwrap();
        assert!((block.normal_y + 1.0).abs() < 1e-6 && block.flatness > 0.8 && block.has_sides, "{block:?}");
        assert!((f64::from(block.y_m) - 1.65).abs() < 0.03, "{block:?}");
        assert_eq!(lines.near(1.5, 1.62, (0.0, -1.0)), None, "nobody sees it from inside");
        let thin = lines.near(1.5, 1.04, (0.0, -1.0)).unwrap();
        assert!(thin.normal_x.abs() < 1e-6 && thin.flatness > 0.8, "{thin:?}");
        assert!((f64::from(thin.y_m) - 1.05).abs() < 0.03, "{thin:?}");
        assert_eq!(lines.near(1.5, 0.5, (0.0, 1.0)), None);
        assert_eq!(lines.near(-4.0, 90.0, (0.0, 1.0)), None);
    }
}
