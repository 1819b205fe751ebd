//! How well a point fits the known map, as a byte per cell of two decimetres: what the search reads.

use crate::KnownMap;
use flockslam_evidence::CellState;
use flockslam_geometry::Point;
use std::ops::Range;

/// Cells of the field are about this wide, metres.
const CELL_M: f64 = 0.2;
/// Width of the influence of what is occupied, metres: a point may be half a cell off by its place and as much by its heading.
const SIGMA_M: f64 = 0.15;
/// The value of a cell of which nothing is known: a point there says little, in free space it speaks against the place.
const UNKNOWN: u8 = 40;
/// No point is farther from the origin of its cloud, metres.
pub(crate) const REACH_M: f64 = 15.0;
/// Stretches of a row where the robot may stand are joined when fewer cells are between them.
const GAP: usize = 8;

/// Likelihood of points over the known map (Thrun et al. 2005, 6.4, with free space apart from unknown).
///
/// Around the map lie as many unknown cells as a point can be away from the robot, so that every place can be summed without a look at
/// the border.
pub struct PlaceField {
    cell_m: f64,
    origin: Point,
    /// Unknown cells on each side.
    border: usize,
    /// A row takes so many entries.
    stride: usize,
    values: Vec<u8>,
    /// By row: where the robot may stand, ranges of columns.
    passable: Vec<Vec<Range<usize>>>,
}

impl PlaceField {
    /// The field of a map.
    pub fn new(map: &KnownMap) -> Self {
        let cells = (CELL_M / map.cell_size_m()).round().max(1.0) as usize;
        let cell_m = map.cell_size_m() * cells as f64;
        // Rounding may put a point a cell farther.
        let border = (REACH_M / cell_m).ceil() as usize + 1;
        let (width, height) = (map.width().div_ceil(cells), map.height().div_ceil(cells));
        let stride = width + 2 * border;
        let mut field = Self {
            cell_m,
            origin: map.origin(),
            border,
            stride,
            values: vec![UNKNOWN; stride * (height + 2 * border)],
            passable: Vec::with_capacity(height),
        };
        for row in 0..height {
            let mut free = Vec::new();
            for column in 0..width {
                let (value, is_free) = cell_of(map, cells, column, row);
                field.values[(row + border) * stride + column + border] = value;
                if is_free {
                    extend(&mut free, column);
                }
            }
            field.passable.push(free);
        }
        field
    }

    /// Side of a cell, metres.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Number of rows.
    pub(crate) fn height(&self) -> usize {
        self.passable.len()
    }

    /// Where the robot may stand in a row: ranges of columns.
    pub(crate) fn passable(&self, row: usize) -> &[Range<usize>] {
        &self.passable[row]
    }

    /// Middle of a cell in the map frame, metres.
    pub(crate) fn middle(&self, column: usize, row: usize) -> (f64, f64) {
        let along = |origin: f64, cell: usize| origin + (cell as f64 + 0.5) * self.cell_m;
        (along(self.origin.x_m, column), along(self.origin.y_m, row))
    }

    /// Columns and rows from the middle of a cell to a point beside it, metres.
    pub(crate) fn steps(&self, x_m: f64, y_m: f64) -> (i32, i32) {
        let steps = |v: f64| (v / self.cell_m).round() as i32;
        (steps(x_m), steps(y_m))
    }

    /// The values of the cells that lie `steps` beside these columns of a row.
    #[inline]
    pub(crate) fn beside(&self, columns: &Range<usize>, row: usize, steps: (i32, i32)) -> &[u8] {
        let shifted = |cell: usize, step: i32| (cell + self.border).wrapping_add_signed(step as isize);
        let start = shifted(row, steps.1) * self.stride + shifted(columns.start, steps.0);
        &self.values[start..start + columns.len()]
    }
}

/// The value of a cell, made of `cells` × `cells` of the map, and whether some of it is free.
fn cell_of(map: &KnownMap, cells: usize, column: usize, row: usize) -> (u8, bool) {
    let (mut distance_m, mut is_free, mut is_known) = (f64::INFINITY, false, false);
    for (i, k) in (0..cells).flat_map(|k| (0..cells).map(move |i| (i, k))) {
        let place = map.cell((column * cells + i) as i64, (row * cells + k) as i64);
        distance_m = distance_m.min(place.distance_m);
        is_free |= place.state == CellState::Free;
        is_known |= place.state != CellState::Unknown;
    }
    let d = distance_m / SIGMA_M;
    let value = if d < 3.0 { (255.0 * libm::exp(-0.5 * d * d)).round() as u8 } else { 0 };
    (if is_known { value } else { value.max(UNKNOWN) }, is_free)
}

/// Adds a column to ranges that end before it.
fn extend(ranges: &mut Vec<Range<usize>>, column: usize) {
    match ranges.last_mut().filter(|last| column <= last.end + GAP) {
        Some(last) => last.end = column + 1,
        None => ranges.push(column..column + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_worth_most_at_what_is_occupied_little_where_nothing_is_known_and_nothing_in_free_space() {
        let mut map = KnownMap::of_width(40, 0.05, Point::new(1.0, 2.0));
        for y in 0..40 {
            let state = |x| match (x, y) {
                (0..4, _) => CellState::Unknown,
                (30.., 8..) => CellState::Occupied,
                _ => CellState::Free,
            };
            map.push_row((0..40).map(state));
        }
        let field = PlaceField::new(&map.measured());
        assert_eq!(field.height(), 10);
        assert_eq!((field.passable(5).len(), field.passable(5)[0].clone()), (1, 1..8));
        let middle = field.middle(3, 2);
        assert!((middle.0 - 1.7).abs() < 1e-9 && (middle.1 - 2.5).abs() < 1e-9);
        let beside =
            |column, row, x_m, y_m| field.beside(&(column..column + 1), row, field.steps(x_m, y_m))[0];
        assert_eq!(beside(2, 5, 1.2, 0.0), 255);
        assert_eq!(beside(2, 5, 0.2, 0.1), 0);
        assert_eq!(beside(2, 5, -0.4, 0.0), UNKNOWN);
        assert_eq!(beside(9, 9, 14.9, 14.9), UNKNOWN);
        assert_eq!(beside(0, 0, -15.0, -15.0), UNKNOWN);
    }
}
