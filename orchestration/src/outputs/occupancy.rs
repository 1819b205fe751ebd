//! A map in three states, cell by cell: free, occupied, unknown. Map files and pictures are made of it.

use flockslam_evidence::CellState;
use flockslam_geometry::Point;

/// Cells in a byte.
const PACKED: usize = 4;

/// A map as a picture of cells, row by row from below: cell (0, 0) is the lower left one, y points up. Each takes two bits.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyImage {
    width: usize,
    height: usize,
    cell_size_m: f64,
    origin: Point,
    /// Each row begins with a byte of its own.
    cells: Vec<u8>,
}

impl OccupancyImage {
    /// A map of `width` × `height` cells of `cell_size_m` whose lower left *corner* is at `origin` in the map frame.
    /// A map without cells becomes a single unknown one, since no picture has zero pixels.
    ///
    /// # Panics
    /// When the number of cells is another one or the cell size is not positive.
    pub fn new(width: usize, height: usize, cell_size_m: f64, origin: Point, cells: Vec<CellState>) -> Self {
        assert_eq!(cells.len(), width * height, "a map of {width} x {height} cells");
        let mut image = Self::of_width(width, cell_size_m, origin);
        cells.chunks_exact(width.max(1)).for_each(|row| image.push_row(row.iter().copied()));
        image.or_one_cell()
    }

    /// A map without rows, so many cells wide, to which rows are added.
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
        self.cells.resize(begin + self.row_bytes(), 0);
        for (x, state) in row.take(self.width).enumerate() {
            self.cells[begin + x / PACKED] |= (state as u8) << (2 * (x % PACKED));
        }
        self.height += 1;
    }

    /// The map itself, or a single unknown cell when it has none.
    #[must_use]
    pub fn or_one_cell(mut self) -> Self {
        if self.width == 0 || self.height == 0 {
            (self.width, self.height, self.cells) = (1, 1, vec![CellState::Unknown as u8]);
        }
        self
    }

    fn row_bytes(&self) -> usize {
        self.width.div_ceil(PACKED)
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

    /// A row of cells, from left to right; row 0 is the lowest.
    ///
    /// # Panics
    /// When there is no such row.
    pub fn row(&self, y: usize) -> impl DoubleEndedIterator<Item = CellState> + ExactSizeIterator {
        assert!(y < self.height, "row {y} of {}", self.height);
        (0..self.width).map(move |x| self.state(x, y))
    }

    fn state(&self, x: usize, y: usize) -> CellState {
        let byte = self.cells[y * self.row_bytes() + x / PACKED];
        CellState::of_bits(byte >> (2 * (x % PACKED)) & 3)
    }

    /// The state of a cell; everything outside is unknown.
    pub fn at(&self, x: i64, y: i64) -> CellState {
        let inside = |value: i64, limit: usize| usize::try_from(value).ok().filter(|v| *v < limit);
        match (inside(x, self.width), inside(y, self.height)) {
            (Some(x), Some(y)) => self.state(x, y),
            _ => CellState::Unknown,
        }
    }

    /// Area of all cells that are free or occupied, m².
    pub fn known_area_m2(&self) -> f64 {
        let known =
            (0..self.height).flat_map(|y| self.row(y)).filter(|cell| *cell != CellState::Unknown).count();
        known as f64 * self.cell_size_m * self.cell_size_m
    }

    /// The box around all known cells, as first and last column and first and last row; `None` when nothing is known.
    pub(super) fn known_box(&self) -> Option<(usize, usize, usize, usize)> {
        let mut found: Option<(usize, usize, usize, usize)> = None;
        for y in 0..self.height {
            let known = |cell: CellState| cell != CellState::Unknown;
            let (Some(left), Some(right)) = (self.row(y).position(known), self.row(y).rposition(known))
            else {
                continue;
            };
            let (min_x, max_x, min_y, _) = found.unwrap_or((left, right, y, y));
            found = Some((min_x.min(left), max_x.max(right), min_y, y));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use CellState::{Free, Occupied, Unknown};

    #[test]
    fn cells_round_trip_at_any_width() {
        for width in 1..10 {
            let state = |i: usize| [Unknown, Free, Occupied][i * i % 7 % 3];
            let cells: Vec<_> = (0..width * 5).map(state).collect();
            let map = OccupancyImage::new(width, 5, 0.05, Point::default(), cells.clone());
            let rows: Vec<_> = (0..5).flat_map(|y| map.row(y)).collect();
            assert_eq!(rows, cells);
            assert_eq!(map.at(width as i64 - 1, 4), cells[width * 5 - 1]);
            assert_eq!([map.at(-1, 0), map.at(width as i64, 0), map.at(0, 5)], [Unknown; 3]);
            assert!(map.cells.len() <= 5 * (width / 4 + 1), "two bits each");
        }
    }
}
