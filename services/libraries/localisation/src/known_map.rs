//! The known map: a grid of free, occupied and unknown cells with the distance to the nearest occupied one, read only.

use crate::scattered_returns::scattered_returns;
use flockslam_evidence::CellState;
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
        let (width, height) = (self.width, self.height);
        let (straight, across) = (STEPS_PER_CELL, STEPS_PER_CELL + 1);
        let mut lower = |x: usize, y: usize, around: [(i64, i64, u8); 4]| {
            let cell = y * width + x;
            let mut least = self.cells[cell] & FAR;
            for (dx, dy, step) in around {
                let (x, y) = (x as i64 + dx, y as i64 + dy);
                if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
                    let other = self.cells[y as usize * width + x as usize] & FAR;
                    least = least.min(other + step);
                }
            }
            self.cells[cell] = (self.cells[cell] & !FAR) | least.min(FAR);
        };
        for y in 0..height {
            for x in 0..width {
                lower(x, y, [(-1, 0, straight), (0, -1, straight), (-1, -1, across), (1, -1, across)]);
            }
        }
        for y in (0..height).rev() {
            for x in (0..width).rev() {
                lower(x, y, [(1, 0, straight), (0, 1, straight), (1, 1, across), (-1, 1, across)]);
            }
        }
        self
    }

    /// The map without scattered returns of ground, grass and leaves: far points would meet some everywhere.
    #[must_use]
    pub(crate) fn without_scattered(&self) -> Self {
        let is_occupied: Vec<bool> =
            self.cells.iter().map(|cell| cell >> STATE_SHIFT == CellState::Occupied as u8).collect();
        let scattered = scattered_returns(&is_occupied, self.width, self.cell_size_m);
        let is_known = |cell: u8| cell >> STATE_SHIFT != CellState::Unknown as u8;
        let mut surfaces = self.clone();
        let is_scattered = scattered.is_patch.iter().zip(&scattered.is_among_many).map(|(a, b)| *a || *b);
        for (cell, is_scattered) in surfaces.cells.iter_mut().zip(is_scattered) {
            if is_scattered && is_known(*cell) {
                *cell = (SCATTERED << STATE_SHIFT) | FAR;
            } else if *cell >> STATE_SHIFT != CellState::Occupied as u8 {
                *cell |= FAR;
            }
        }
        surfaces.measured()
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
        ((x_m - self.origin.x_m) / self.cell_size_m).floor() as i64
    }

    /// Row of a y coordinate, metres; it need not lie in the map.
    #[inline]
    pub fn row(&self, y_m: f64) -> i64 {
        ((y_m - self.origin.y_m) / self.cell_size_m).floor() as i64
    }

    /// Middle of a cell in the map frame, metres.
    pub fn middle(&self, column: i64, row: i64) -> (f64, f64) {
        let along = |origin: f64, cell: i64| origin + (cell as f64 + 0.5) * self.cell_size_m;
        (along(self.origin.x_m, column), along(self.origin.y_m, row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
