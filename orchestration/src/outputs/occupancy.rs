//! A map in three states, cell by cell: free, occupied, unknown. Map files and pictures are made of it.

use flockslam_geometry::Point;

/// What is known of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CellState {
    /// Nothing.
    #[default]
    Unknown,
    /// Nothing stands there.
    Free,
    /// Something stands there.
    Occupied,
}

/// A map as a picture of cells, row by row from below: cell (0, 0) is the lower left one, y points up.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyImage {
    width: usize,
    height: usize,
    cell_size_m: f64,
    origin: Point,
    cells: Vec<CellState>,
}

impl OccupancyImage {
    /// A map of `width` × `height` cells of `cell_size_m` whose lower left *corner* lies at `origin` in the map frame.
    /// A map without cells becomes a single unknown one, since no picture has zero pixels.
    ///
    /// # Panics
    /// When the number of cells is another one or the cell size is not positive.
    pub fn new(width: usize, height: usize, cell_size_m: f64, origin: Point, cells: Vec<CellState>) -> Self {
        assert_eq!(cells.len(), width * height, "a map of {width} x {height} cells");
        assert!(cell_size_m > 0.0 && cell_size_m.is_finite(), "a cell of {cell_size_m} m");
        if cells.is_empty() {
            return Self { width: 1, height: 1, cell_size_m, origin, cells: vec![CellState::Unknown] };
        }
        Self { width, height, cell_size_m, origin, cells }
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
    pub fn row(&self, y: usize) -> &[CellState] {
        &self.cells[y * self.width..(y + 1) * self.width]
    }

    /// The state of a cell; everything outside is unknown.
    pub fn at(&self, x: i64, y: i64) -> CellState {
        let inside = |value: i64, limit: usize| usize::try_from(value).ok().filter(|v| *v < limit);
        match (inside(x, self.width), inside(y, self.height)) {
            (Some(x), Some(y)) => self.cells[y * self.width + x],
            _ => CellState::Unknown,
        }
    }

    /// Area of all cells that are free or occupied, m².
    pub fn known_area_m2(&self) -> f64 {
        let known = self.cells.iter().filter(|cell| **cell != CellState::Unknown).count();
        known as f64 * self.cell_size_m * self.cell_size_m
    }

    /// The box around all known cells, as first and last column and first and last row; `None` when nothing is known.
    pub(super) fn known_box(&self) -> Option<(usize, usize, usize, usize)> {
        let mut found: Option<(usize, usize, usize, usize)> = None;
        for y in 0..self.height {
            let known = |cell: &CellState| *cell != CellState::Unknown;
            let (Some(left), Some(right)) =
                (self.row(y).iter().position(known), self.row(y).iter().rposition(known))
            else {
                continue;
            };
            let (min_x, max_x, min_y, _) = found.unwrap_or((left, right, y, y));
            found = Some((min_x.min(left), max_x.max(right), min_y, y));
        }
        found
    }
}
