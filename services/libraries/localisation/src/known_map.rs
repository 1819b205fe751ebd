//! The known map: a grid of free, occupied and unknown cells with the distance to the nearest occupied one, read only.

use crate::scattered_returns::scattered_returns;
use flockslam_evidence::{CellState, floor};
use flockslam_geometry::Point;

/// Distances are kept up to this many steps …
const FAR: u8 = 63;
/// … of which this many make a cell's side (a chamfer of 3 and 4, Borgefors 1986).
const STEPS_PER_CELL: u8 = 3;
/// Bits of the state in a cell's byte.
const STATE_SHIFT: u8 = 6;
/// The state of a cell among scattered returns, beside those of [`CellState`].
const SCATTERED: u8 = 3;

/// A grid map that is known and never edited.
///
/// One byte a cell: its state and the distance to the nearest occupied cell.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownMap {
    width: usize,
    height: usize,
    cell_size_m: f64,
    origin: Point,
    cells: Vec<u8>,
}

/// What a place of the map is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The state of its cell.
    pub state: CellState,
    /// Distance from the middle of the cell to that of the nearest occupied one, metres; what is far is no farther than 21 cells.
    pub distance_m: f64,
    /// It lies among scattered returns of ground or grass: beams end there, or pass, at random.
    pub is_scattered: bool,
}

/// Some cells together.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Square {
    /// Least distance to an occupied cell, of those of [`KnownMap::distances_m`].
    pub(crate) distance_steps: u8,
    /// A cell is free or occupied, and not among scattered returns.
    pub(crate) is_known: bool,
    /// Cells that are free, and that are occupied.
    pub(crate) free: u32,
    pub(crate) occupied: u32,
}

impl Default for Square {
    fn default() -> Self {
        Self { distance_steps: FAR, is_known: false, free: 0, occupied: 0 }
    }
}

impl Square {
    fn add(&mut self, cell: u8) {
        let state = cell >> STATE_SHIFT;
        let (is_free, is_occupied) = (state == CellState::Free as u8, state == CellState::Occupied as u8);
        self.distance_steps = self.distance_steps.min(cell & FAR);
        self.is_known |= is_free || is_occupied;
        self.free += u32::from(is_free || state == SCATTERED);
        self.occupied += u32::from(is_occupied);
    }
}

impl KnownMap {
    /// An empty map of so many cells in a row, whose lower left corner is at `origin`, to which rows are added.
    ///
    /// # Panics
    /// When the cell size is not positive.
    pub fn of_width(width: usize, cell_size_m: f64, origin: Point) -> Self {
        assert!(cell_size_m > 0.0 && cell_size_m.is_finite(), "a cell of {cell_size_m} m");
        Self { width, height: 0, cell_size_m, origin, cells: Vec::new() }
    }

    /// Adds the next row above the others; cells that it lacks are unknown.
    pub fn push_row(&mut self, row: impl Iterator<Item = CellState>) {
        let begin = self.cells.len();
        let far = |state: CellState| {
            let distance = if state == CellState::Occupied { 0 } else { FAR };
            ((state as u8) << STATE_SHIFT) | distance
        };
        self.cells.extend(row.take(self.width).map(far));
        self.cells.resize(begin + self.width, far(CellState::Unknown));
        self.height += 1;
    }

    /// The map with all distances worked out, once it has all rows.
    #[must_use]
    pub fn measured(mut self) -> Self {
        let width = self.width.max(1);
        // Distances of the row before, with a cell far from everything at both ends.
        let mut before = vec![FAR; self.width + 2];
        for row in self.cells.chunks_exact_mut(width) {
            lower_beside(row, &before);
            lower_along(row.iter_mut());
            before[1..].iter_mut().zip(&*row).for_each(|(distance, cell)| *distance = cell & FAR);
        }
        before.fill(FAR);
        for row in self.cells.chunks_exact_mut(width).rev() {
            lower_beside(row, &before);
            lower_along(row.iter_mut().rev());
            before[1..].iter_mut().zip(&*row).for_each(|(distance, cell)| *distance = cell & FAR);
        }
        self
    }

    /// The map without scattered returns of ground, grass and leaves: far points would meet some everywhere.
    #[must_use]
    pub(crate) fn without_scattered(&self) -> Self {
        let is_occupied = self.cells.iter().map(|cell| cell >> STATE_SHIFT == CellState::Occupied as u8);
        let marks = scattered_returns(is_occupied, self.width, self.cell_size_m);
        let is_known = |cell: u8| cell >> STATE_SHIFT != CellState::Unknown as u8;
        let mut surfaces = self.clone();
        for (cell, mark) in surfaces.cells.iter_mut().zip(marks) {
            if mark.is_scattered() && is_known(*cell) {
                *cell = (SCATTERED << STATE_SHIFT) | FAR;
            } else if *cell >> STATE_SHIFT != CellState::Occupied as u8 {
                *cell |= FAR;
            }
        }
        surfaces.measured()
    }

    /// Columns of the occupied cells of a row, in order.
    pub(crate) fn occupied_columns(&self, row: usize) -> impl Iterator<Item = usize> + '_ {
        let cells = self.cells[row * self.width..][..self.width].iter().enumerate();
        cells.filter(|(_, cell)| **cell >> STATE_SHIFT == CellState::Occupied as u8).map(|(column, _)| column)
    }

    /// A row of squares of `side` × `side` cells, the first at the first column; what lies beyond the map is unknown.
    pub(crate) fn squares(&self, row: usize, side: usize, squares: &mut [Square]) {
        squares.fill(Square::default());
        let rows = row * side..((row + 1) * side).min(self.height);
        let cells = &self.cells[rows.start * self.width..rows.end * self.width];
        for cells in cells.chunks_exact(self.width.max(1)) {
            for (square, cells) in squares.iter_mut().zip(cells.chunks(side)) {
                cells.iter().for_each(|cell| square.add(*cell));
            }
        }
    }

    /// The distances of [`Square::distance_steps`], metres, from 0 steps on.
    pub(crate) fn distances_m(&self) -> impl Iterator<Item = f64> {
        let cell_size_m = self.cell_size_m;
        (0..=FAR).map(move |steps| f64::from(steps) * cell_size_m / f64::from(STEPS_PER_CELL))
    }

    /// Cells along x.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Cells along y.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Side of a cell, metres.
    pub fn cell_size_m(&self) -> f64 {
        self.cell_size_m
    }

    /// Lower left corner in the map frame.
    pub fn origin(&self) -> Point {
        self.origin
    }

    /// Area of all cells that are free or occupied, m².
    pub fn known_area_m2(&self) -> f64 {
        let known = self.cells.iter().filter(|cell| *cell >> STATE_SHIFT != CellState::Unknown as u8);
        known.count() as f64 * self.cell_size_m * self.cell_size_m
    }

    /// A cell by its column and row; what is outside is unknown and far from everything.
    #[inline]
    pub fn cell(&self, column: i64, row: i64) -> Place {
        let inside = (0..self.width as i64).contains(&column) && (0..self.height as i64).contains(&row);
        let byte = if inside { self.cells[row as usize * self.width + column as usize] } else { FAR };
        let is_scattered = byte >> STATE_SHIFT == SCATTERED;
        let state = if is_scattered { CellState::Free } else { CellState::of_bits(byte >> STATE_SHIFT) };
        let distance_m = f64::from(byte & FAR) * self.cell_size_m / f64::from(STEPS_PER_CELL);
        Place { state, distance_m, is_scattered }
    }

    /// The cell that holds a point of the map frame, metres.
    #[inline]
    pub fn at(&self, x_m: f64, y_m: f64) -> Place {
        self.cell(self.column(x_m), self.row(y_m))
    }

    /// Column of an x coordinate, metres; it need not lie in the map.
    #[inline]
    pub fn column(&self, x_m: f64) -> i64 {
        i64::from(floor((x_m - self.origin.x_m) / self.cell_size_m))
    }

    /// Row of a y coordinate, metres; it need not lie in the map.
    #[inline]
    pub fn row(&self, y_m: f64) -> i64 {
        i64::from(floor((y_m - self.origin.y_m) / self.cell_size_m))
    }

    /// Middle of a cell in the map frame, metres.
    pub fn middle(&self, column: i64, row: i64) -> (f64, f64) {
        let along = |origin: f64, cell: i64| origin + (cell as f64 + 0.5) * self.cell_size_m;
        (along(self.origin.x_m, column), along(self.origin.y_m, row))
    }
}

fn lower(cell: &mut u8, distance: u8) {
    *cell = (*cell & !FAR) | distance.min(*cell & FAR);
}

/// Lowers the distances of a row to what the row beside it allows, whose distances begin one cell earlier.
fn lower_beside(row: &mut [u8], beside: &[u8]) {
    let (straight, across) = (STEPS_PER_CELL, STEPS_PER_CELL + 1);
    for (cell, near) in row.iter_mut().zip(beside.windows(3)) {
        lower(cell, (near[1] + straight).min(near[0].min(near[2]) + across));
    }
}

/// Lowers the distances of cells in a line to what the one before each allows.
fn lower_along<'a>(cells: impl Iterator<Item = &'a mut u8>) {
    cells.fold(FAR, |before, cell| {
        lower(cell, before + STEPS_PER_CELL);
        *cell & FAR
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Surroundings;

    #[test]
    fn a_map_without_columns_or_without_rows_can_be_prepared() {
        for (width, rows) in [(0, 0), (0, 3), (7, 0), (1, 1)] {
            let mut map = KnownMap::of_width(width, 0.05, Point::default());
            (0..rows).for_each(|_| map.push_row(std::iter::repeat(CellState::Unknown)));
            let surroundings = Surroundings::new(map.measured());
            assert_eq!(surroundings.map().known_area_m2(), 0.0, "{width} x {rows}");
        }
    }

    #[test]
    fn distances_are_those_to_the_nearest_occupied_cell() {
        let mut map = KnownMap::of_width(9, 0.1, Point::new(-0.2, 1.0));
        for row in 0..7 {
            let state = |x| if (row, x) == (2, 3) { CellState::Occupied } else { CellState::Free };
            map.push_row((0..8).map(state));
        }
        let map = map.measured();
        assert_eq!(
            map.at(0.15, 1.25),
            Place { state: CellState::Occupied, distance_m: 0.0, is_scattered: false }
        );
        assert!((map.cell(7, 2).distance_m - 0.4).abs() < 1e-9);
        let across = map.cell(0, 5).distance_m;
        assert!((across - 0.3 * 2f64.sqrt()).abs() < 0.03, "{across}");
        assert_eq!(map.cell(8, 0).state, CellState::Unknown, "the row was short");
        assert_eq!(map.at(-5.0, 0.0).state, CellState::Unknown);
        assert!((map.known_area_m2() - 0.56).abs() < 1e-9);
    }
}
