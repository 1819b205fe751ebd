//! How well a point fits the known map, as a byte per cell of two decimetres: what the search reads.

use crate::KnownMap;
use crate::known_map::Square;
use flockslam_geometry::Point;
use flockslam_geometry::elementary::exp;
use std::ops::Range;

/// Cells of the field are about this wide, metres; so many times that for a cloud whose points are far away, as outdoors: the same step of
/// headings moves these so much more.
const CELL_M: f64 = 0.2;
const WIDE: f64 = 2.0;
/// Width of the influence of what is occupied, metres: a point may be half a cell off by its place and as much by its heading.
const SIGMA_M: f64 = 0.15;
/// The value of an unknown cell: a point there has little weight, in free space it counts against the pose.
pub const UNKNOWN: u8 = 40;
/// The value of an unknown cell for a sample of free space.
const FREE_IN_UNKNOWN: u8 = 60;
/// The same for a robot that may see much that the map does not have: at its pose, many points are in unknown cells.
pub const MUCH_UNKNOWN: u8 = 130;
/// No point is farther from the origin of its cloud, metres; so many times that in the wide field.
pub(crate) const REACH_M: f64 = 15.0;
/// A block has so many cells along each side.
pub(crate) const BLOCK: usize = 4;
/// Cells of a block.
pub(crate) const CELLS: usize = BLOCK * BLOCK;
/// So many points of a block are summed up before its bound is looked at again.
const EXACT_AT_ONCE: usize = 8;
/// So many blocks side by side are summed up at once.
pub(crate) const LANES: usize = 32;

/// Likelihood of points over the known map (Thrun et al. 2005, 6.4, with free space apart from unknown).
///
/// Around the map lie as many unknown cells as a point can be away from the robot, so that every place can be summed without a check of
/// the border. Cells are taken together in blocks of 4 × 4, of which a bound is known: no cell of a block sums up to more.
pub struct PlaceField {
    cell_m: f64,
    /// Reach of the points, metres.
    reach_m: f64,
    origin: Point,
    /// Unknown cells on each side.
    border: usize,
    /// A row of cells takes so many entries.
    stride: usize,
    /// The value of each cell and of those in the next rows of its column: a block at any cell is one piece.
    columns: Vec<[u8; BLOCK]>,
    /// The greatest value of the block that begins at each cell, in a plane for each column and row within a block at which it may begin.
    bounds: Vec<u8>,
    /// Entries of a plane, and of a row in it.
    plane: usize,
    bound_stride: usize,
    /// Rows of cells.
    height: usize,
    /// Where the values, and the bounds, of free samples begin, where the field has them.
    free: Option<(usize, usize)>,
    /// Of each block with a cell where the robot may stand a bit for each of those, row by row; of all others 0.
    passable: Vec<u16>,
    /// Blocks in a row, without the border.
    blocks: usize,
}

/// Blocks side by side: a row, and the first of at most [`LANES`] columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stretch {
    pub(crate) row: usize,
    pub(crate) column: usize,
    pub(crate) count: usize,
}

impl PlaceField {
    /// The field of a map in which an unknown cell has this value.
    pub fn new(map: &KnownMap, unknown: u8) -> Self {
        Self::scaled(map, unknown, 1.0, false)
    }

    /// The same for points twice as far away, with cells twice as wide, and with values for samples of free space.
    pub fn wide(map: &KnownMap, unknown: u8) -> Self {
        Self::scaled(map, unknown, WIDE, true)
    }

    fn scaled(map: &KnownMap, unknown: u8, scale: f64, has_free: bool) -> Self {
        let (reach_m, sigma_m) = (scale * REACH_M, scale * SIGMA_M);
        let cells = (scale * CELL_M / map.cell_size_m()).round().max(1.0) as usize;
        let cell_m = map.cell_size_m() * cells as f64;
        // Rounding may put a point a cell farther.
        let border = (reach_m / cell_m).ceil() as usize + 1;
        let (width, height) = (map.width().div_ceil(cells), map.height().div_ceil(cells));
        let (blocks, block_rows) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
        // Whole blocks, and as many beside the last one as are summed up with it.
        let stride = (blocks + LANES) * BLOCK + 2 * border;
        let rows = block_rows * BLOCK + 2 * border;
        let mut values = vec![unknown; stride * rows];
        let mut free_values = vec![FREE_IN_UNKNOWN; if has_free { values.len() } else { 0 }];
        let mut passable = vec![0; blocks * block_rows];
        let of_distance: Vec<u8> =
            map.distances_m().map(|distance_m| value_at(distance_m / sigma_m)).collect();
        let mut squares = vec![Square::default(); width];
        for row in 0..height {
            map.squares(row, cells, &mut squares);
            let begin = (row + border) * stride + border;
            for (column, square) in squares.iter().enumerate() {
                let value = of_distance[usize::from(square.distance_steps)];
                values[begin + column] = if square.is_known { value } else { value.max(unknown) };
                if has_free {
                    free_values[begin + column] = free_value(square, cells);
                }
                if square.free > 0 {
                    passable[row / BLOCK * blocks + column / BLOCK] |= bit(column % BLOCK, row % BLOCK);
                }
            }
        }
        let bound_stride = stride.div_ceil(BLOCK);
        let plane = bound_stride * rows.div_ceil(BLOCK);
        let mut of_bounds = bounds(&values, stride, bound_stride, plane);
        let mut columns = columns_of(&values, stride);
        let free = if has_free { Some((columns.len(), of_bounds.len())) } else { None };
        if has_free {
            of_bounds.extend(bounds(&free_values, stride, bound_stride, plane));
            columns.extend(columns_of(&free_values, stride));
        }
        let origin = map.origin();
        Self {
            cell_m,
            reach_m,
            origin,
            border,
            stride,
            columns,
            bounds: of_bounds,
            plane,
            bound_stride,
            free,
            height,
            passable,
            blocks,
        }
    }

    /// No point is farther from the origin of its cloud than this, metres.
    pub fn reach_m(&self) -> f64 {
        self.reach_m
    }

    /// Side of a cell, metres.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Number of rows of blocks.
    pub(crate) fn block_rows(&self) -> usize {
        self.height.div_ceil(BLOCK)
    }

    /// Blocks where the robot may stand, within rows and columns of blocks, in order.
    pub(crate) fn stretches(&self, rows: Range<usize>, columns: Range<usize>) -> Vec<Stretch> {
        let columns = columns.start..columns.end.min(self.blocks);
        let mut found: Vec<Stretch> = Vec::new();
        for row in rows.start..rows.end.min(self.block_rows()) {
            for column in columns.clone().filter(|column| self.passable(row, *column) != 0) {
                match found.last_mut().filter(|last| last.row == row && column < last.column + LANES) {
                    Some(last) => last.count = column - last.column + 1,
                    None => found.push(Stretch { row, column, count: 1 }),
                }
            }
        }
        found
    }

    /// Where the robot may stand in a block: a bit for each cell.
    pub(crate) fn passable(&self, row: usize, column: usize) -> u16 {
        self.passable[row * self.blocks + column]
    }

    /// Middle of a cell in the map frame, metres.
    pub(crate) fn middle(&self, column: usize, row: usize) -> (f64, f64) {
        let along = |origin: f64, cell: usize| origin + (cell as f64 + 0.5) * self.cell_m;
        (along(self.origin.x_m, column), along(self.origin.y_m, row))
    }

    /// The block that holds a place, of a map without bounds.
    pub(crate) fn block_at(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        let along = |v: f64, origin: f64| ((v - origin) / (self.cell_m * BLOCK as f64)).floor();
        (along(x_m, self.origin.x_m), along(y_m, self.origin.y_m))
    }

    /// Where the value of a point beside the robot is, from that of the robot's cell on, and its bound from that of the block: `x_m` and
    /// `y_m` from the middle of the cell.
    pub(crate) fn offsets(&self, x_m: f64, y_m: f64) -> (usize, usize) {
        let step = |v: f64| self.border.wrapping_add_signed((v / self.cell_m).round() as isize);
        let (column, row) = (step(x_m), step(y_m));
        let plane = (row % BLOCK * BLOCK + column % BLOCK) * self.plane;
        (row * self.stride + column, plane + row / BLOCK * self.bound_stride + column / BLOCK)
    }

    /// The same for a sample of free space; `None` where the field has none of these.
    pub(crate) fn free_offsets(&self, x_m: f64, y_m: f64) -> Option<(usize, usize)> {
        let (values, bounds) = self.free?;
        let (value, bound) = self.offsets(x_m, y_m);
        Some((values + value, bounds + bound))
    }

    /// Whether it has values of samples of free space.
    pub(crate) fn has_free(&self) -> bool {
        self.free.is_some()
    }

    /// Bounds of the sums of all points for the blocks of a stretch.
    pub(crate) fn bounds(&self, stretch: Stretch, offsets: &[(usize, usize)]) -> [u16; LANES] {
        let from = &self.bounds[stretch.row * self.bound_stride + stretch.column..];
        let mut sums = [0; LANES];
        for (_, offset) in offsets {
            let bounds: &[u8; LANES] = from[*offset..].first_chunk().expect("the border is wide enough");
            sums.iter_mut().zip(bounds).for_each(|(sum, bound): (&mut u16, _)| *sum += u16::from(*bound));
        }
        sums
    }

    /// The sums of all points for the cells of a block, row by row; `None` when none is at least this. `bound` is that of the block.
    pub(crate) fn sums(
        &self,
        (row, column): (usize, usize),
        offsets: &[(usize, usize)],
        bound: u16,
        least: u16,
    ) -> Option<[u16; CELLS]> {
        let block = row * BLOCK * self.stride + column * BLOCK;
        let (columns, bounds) = (&self.columns[block..], &self.bounds[row * self.bound_stride + column..]);
        // Column by column, as the cells lie.
        let (mut sums, mut rest) = ([0; CELLS], bound);
        // What is exact replaces what is bounded, until that is too low.
        for offsets in offsets.chunks(EXACT_AT_ONCE) {
            for (exact, bounded) in offsets {
                let columns: &[[u8; BLOCK]; BLOCK] =
                    columns[*exact..].first_chunk().expect("the border is wide enough");
                sums.iter_mut()
                    .zip(columns.as_flattened())
                    .for_each(|(sum, v): (&mut u16, _)| *sum += u16::from(*v));
                rest -= u16::from(bounds[*bounded]);
            }
            if sums.iter().max().is_none_or(|most| most + rest < least) {
                return None;
            }
        }
        Some(std::array::from_fn(|cell| sums[cell % BLOCK * BLOCK + cell / BLOCK]))
    }
}

/// The bit of a cell of a block.
pub(crate) fn bit(column: usize, row: usize) -> u16 {
    1 << (row * BLOCK + column)
}

/// Of each cell its value and those below in its column, row by row; below the last row they are 0.
fn columns_of(values: &[u8], stride: usize) -> Vec<[u8; BLOCK]> {
    let below = |cell: usize, rows: usize| values.get(cell + rows * stride).copied().unwrap_or(0);
    (0..values.len()).map(|cell| [0, 1, 2, 3].map(|rows| below(cell, rows))).collect()
}

/// The greatest value of the block that begins at each cell, plane by plane.
fn bounds(values: &[u8], stride: usize, bound_stride: usize, plane: usize) -> Vec<u8> {
    let mut bounds = vec![u8::MAX; BLOCK * BLOCK * plane];
    // Of each cell the greatest value from it to the right.
    let mut across = values.to_vec();
    for row in across.chunks_exact_mut(stride) {
        for column in 0..stride {
            row[column] = row[column..(column + BLOCK).min(stride)].iter().copied().fold(0, u8::max);
        }
    }
    let rows = values.len() / stride;
    let mut greatest = vec![0; stride];
    for row in 0..rows {
        greatest.fill(0);
        for row in across[row * stride..(row + BLOCK).min(rows) * stride].chunks_exact(stride) {
            greatest.iter_mut().zip(row).for_each(|(most, value): (&mut u8, _)| *most = (*most).max(*value));
        }
        for phase in 0..BLOCK {
            let to = &mut bounds[(row % BLOCK * BLOCK + phase) * plane + row / BLOCK * bound_stride..];
            to.iter_mut().zip(greatest[phase..].iter().step_by(BLOCK)).for_each(|(to, most)| *to = *most);
        }
    }
    bounds
}

/// The value of a point so many standard deviations from what is occupied.
fn value_at(deviations: f64) -> u8 {
    if deviations < 3.0 { (255.0 * exp(-0.5 * deviations * deviations)).round() as u8 } else { 0 }
}

/// The value of a square of `cells` × `cells` cells for a sample of free space.
fn free_value(square: &Square, cells: usize) -> u8 {
    if square.occupied > 0 {
        0
    } else if 4 * square.free as usize >= cells * cells {
        u8::MAX
    } else {
        FREE_IN_UNKNOWN
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::CellState;

    #[test]
    fn a_sample_of_free_space_scores_most_in_free_little_in_unknown_and_nothing_in_occupied_cells() {
        let mut map = KnownMap::of_width(40, 0.1, Point::default());
        for _ in 0..40 {
            let state = |x| match x {
                0..8 => CellState::Unknown,
                30 => CellState::Occupied,
                _ => CellState::Free,
            };
            map.push_row((0..40).map(state));
        }
        let field = PlaceField::wide(&map.measured(), UNKNOWN);
        let at = |column: usize| {
            let offsets = [field.free_offsets(0.0, 0.0).unwrap()];
            field.sums((0, column / BLOCK), &offsets, 255, 0).unwrap()[column % BLOCK]
        };
        assert_eq!([0, 4, 7].map(at), [u16::from(FREE_IN_UNKNOWN), 255, 0]);
        let bound =
            field.bounds(Stretch { row: 0, column: 0, count: 2 }, &[field.free_offsets(0.0, 0.0).unwrap()]);
        assert_eq!(bound[..2], [255, 255]);
        assert_eq!(PlaceField::new(&map_of_one_cell(), UNKNOWN).free_offsets(0.0, 0.0), None);
    }

    fn map_of_one_cell() -> KnownMap {
        let mut map = KnownMap::of_width(1, 0.1, Point::default());
        map.push_row([CellState::Free].into_iter());
        map.measured()
    }

    #[test]
    fn a_point_scores_most_in_occupied_little_in_unknown_and_nothing_in_free_cells() {
        let mut map = KnownMap::of_width(40, 0.05, Point::new(1.0, 2.0));
        for y in 0..40 {
            let state = |x| match (x, y) {
                (0..4, _) => CellState::Unknown,
                (30.., 8..) => CellState::Occupied,
                _ => CellState::Free,
            };
            map.push_row((0..40).map(state));
        }
        let field = PlaceField::new(&map.measured(), UNKNOWN);
        assert_eq!(field.block_rows(), 3);
        // Columns from 1 to 7 are free where rows are below 2, and columns from 1 to 7 with half of them above.
        assert_eq!(field.passable(0, 0), 0b1110_1110_1110_1110);
        assert_eq!(field.stretches(0..9, 1..2), [0, 1, 2].map(|row| Stretch { row, column: 1, count: 1 }));
        let middle = field.middle(3, 2);
        assert!((middle.0 - 1.7).abs() < 1e-9 && (middle.1 - 2.5).abs() < 1e-9);
        let beside = |column: usize, row: usize, x_m, y_m| {
            let block = (row / BLOCK, column / BLOCK);
            let sums = field.sums(block, &[field.offsets(x_m, y_m)], 255, 0).unwrap();
            sums[row % BLOCK * BLOCK + column % BLOCK]
        };
        assert_eq!(beside(2, 5, 1.2, 0.0), 255);
        assert_eq!(beside(2, 5, 0.2, 0.1), 0);
        assert_eq!(beside(2, 5, -0.4, 0.0), u16::from(UNKNOWN));
        assert_eq!(beside(9, 9, 14.9, 14.9), u16::from(UNKNOWN));
        assert_eq!(beside(0, 0, -15.0, -15.0), u16::from(UNKNOWN));
    }
}
