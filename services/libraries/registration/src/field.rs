//! The likelihood field that scans are fitted to: scores over the plane in several resolutions, and interpolation between cells.

use flockslam_evidence::{CellIndex, Level, ScoreReader, Tile, TileGrid, floor};
use flockslam_geometry::Point;
use std::ops::Deref;

const UNIT: f64 = 1.0 / u16::MAX as f64;

/// A smooth score over the plane in several resolutions: the likelihood field that scans are fitted to.
pub trait ScoreField {
    /// Reads of one level.
    type Reader<'a>: ScoreRead
    where
        Self: 'a;

    /// Starts reading a level.
    fn reader(&self, level: Level) -> Self::Reader<'_>;

    /// Whether the field has scores near a point.
    fn covers(&self, point: Point) -> bool;
}

/// Reads of one level of a [`ScoreField`].
pub trait ScoreRead {
    /// Side of a cell, metres.
    fn cell_size_m(&self) -> f64;

    /// Score of a cell, 0 … 65535 for 0 … 1.
    fn cell(&mut self, cell: CellIndex) -> u16;

    /// Scores of the cells (0, 0), (1, 0), (0, 1), (1, 1) counted from `cell`.
    fn block(&mut self, cell: CellIndex) -> [u16; 4];

    /// Scores of the cells of a row, from `first` on to the right.
    fn row(&mut self, first: CellIndex, scores: &mut [u16]);
}

/// Score and its derivative at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Score, 0 … 1.
    pub value: f64,
    /// Derivative along x, per metre.
    pub slope_x: f64,
    /// Derivative along y, per metre.
    pub slope_y: f64,
}

/// Bilinear interpolation between the centres of cells, with its true derivative; `per_metre` is one over the side
/// of a cell (passed in since divisions are slow).
#[inline]
pub fn bilinear(read: &mut impl ScoreRead, per_metre: f64, x_m: f64, y_m: f64) -> Sample {
    let (u, v) = (x_m * per_metre - 0.5, y_m * per_metre - 0.5);
    let (i, j) = (floor(u), floor(v));
    let (a, b) = (u - f64::from(i), v - f64::from(j));
    let [m00, m10, m01, m11] = read.block(CellIndex::new(i, j)).map(f64::from);
    let (low, high) = (m10 - m00, m11 - m01);
    let (bottom, top) = (m00 + a * low, m01 + a * high);
    let slope = UNIT * per_metre;
    Sample {
        value: UNIT * (bottom + b * (top - bottom)),
        slope_x: slope * (low + b * (high - low)),
        slope_y: slope * (top - bottom),
    }
}

/// Score of the cell that contains a point, 0 … 1.
#[inline]
pub fn nearest(read: &mut impl ScoreRead, per_metre: f64, x_m: f64, y_m: f64) -> f64 {
    UNIT * f64::from(read.cell(CellIndex::new(floor(x_m * per_metre), floor(y_m * per_metre))))
}

/// The scores of an evidence grid.
#[derive(Debug)]
pub struct GridField<'a, H> {
    grid: &'a TileGrid<H>,
    outside: u16,
}

impl<'a, H: Deref<Target = Tile>> GridField<'a, H> {
    /// The scores of `grid`; `outside` (0 … 1) holds where it has no tile.
    pub fn new(grid: &'a TileGrid<H>, outside: f64) -> Self {
        Self { grid, outside: (outside * f64::from(u16::MAX)).round() as u16 }
    }
}

impl<H: Deref<Target = Tile>> ScoreField for GridField<'_, H> {
    type Reader<'a>
        = ScoreReader<'a, H>
    where
        Self: 'a;

    fn reader(&self, level: Level) -> ScoreReader<'_, H> {
        self.grid.scores(level, self.outside)
    }

    fn covers(&self, point: Point) -> bool {
        self.grid.tile(self.grid.cell_at(point).tile()).is_some()
    }
}

impl<H: Deref<Target = Tile>> ScoreRead for ScoreReader<'_, H> {
    fn cell_size_m(&self) -> f64 {
        ScoreReader::cell_size_m(self)
    }

    #[inline]
    fn cell(&mut self, cell: CellIndex) -> u16 {
        ScoreReader::cell(self, cell)
    }

    #[inline]
    fn block(&mut self, cell: CellIndex) -> [u16; 4] {
        ScoreReader::block(self, cell)
    }

    fn row(&mut self, first: CellIndex, scores: &mut [u16]) {
        ScoreReader::row(self, first, scores);
    }
}
