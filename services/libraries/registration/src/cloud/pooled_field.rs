//! Scores around the points of a submap with maxima over growing squares: what the search by branch and bound reads.

use super::MomentGrid;
use flockslam_evidence::floor;
use flockslam_geometry::elementary::exp;

/// Side of a cell, metres.
const CELL_M: f64 = MomentGrid::CELL_M;
/// Reach of a point's influence, cells.
const REACH: i32 = 3;
/// Width of a point's influence, metres.
const SIGMA_M: f64 = 0.1;
/// Levels of pooling above the finest.
const LEVELS: usize = 7;
/// Points farther than this from the frame's origin are left out, metres: a submap's memory stays bounded whatever poses it
/// was made from.
const EXTENT_MAX_M: f64 = 60.0;
/// Points that are added up between two bound checks: their values fit into 16 bits.
const CHUNK: usize = 16;
/// Steps of the influence table per m² of squared distance.
const STEPS_PER_M2: f64 = 8000.0;

/// One resolution: the entry (c, r) is the largest value over the finest cells `[c·2ᵏ, (c+2)·2ᵏ)` in both
/// directions.
struct Level {
    width: usize,
    height: usize,
    values: Vec<u8>,
}

/// How well a point fits a submap, exp(-d²/2σ²) of the distance d to its nearest point as a byte per cell,
/// with maxima over growing squares.
///
/// A level's entry spans twice its stride, so it bounds a point that is shifted by less than the stride from
/// wherever it is in its own square: what branch and bound needs (Olson 2009; Hess et al. 2016), at a
/// third more memory than the finest level instead of a full copy for each level.
pub struct PooledField {
    origin_column: i32,
    origin_row: i32,
    levels: Vec<Level>,
}

impl PooledField {
    /// The field of a submap's points, metres in its frame.
    pub fn new(points: &[(f64, f64)]) -> Self {
        let near = |p: &&(f64, f64)| p.0.abs() < EXTENT_MAX_M && p.1.abs() < EXTENT_MAX_M;
        let points: Vec<(f64, f64)> = points.iter().filter(near).copied().collect();
        let cells: Vec<(i32, i32)> = points.iter().map(|&(x, y)| (Self::cell(x), Self::cell(y))).collect();
        let bound = |pick: fn(&(i32, i32)) -> i32| {
            let low = cells.iter().map(pick).min().unwrap_or(0) - REACH;
            let high = cells.iter().map(pick).max().unwrap_or(0) + REACH;
            (low, (high - low + 1) as usize)
        };
        let ((origin_column, width), (origin_row, height)) = (bound(|c| c.0), bound(|c| c.1));
        let mut finest = Level { width, height, values: vec![0; width * height] };
        let table = influence_table();
        for (&(x, y), &(column, row)) in points.iter().zip(&cells) {
            spread(&mut finest, &table, (x, y), (column, row), (origin_column, origin_row));
        }
        let mut levels = vec![finest];
        for k in 1..=LEVELS {
            levels.push(pooled(&levels[k - 1], k == 1));
        }
        Self { origin_column, origin_row, levels }
    }

    /// The column or row that holds a coordinate.
    #[inline]
    pub(super) fn cell(metres: f64) -> i32 {
        floor(metres * (1.0 / CELL_M))
    }

    /// The highest level.
    pub(super) fn top(&self) -> usize {
        self.levels.len() - 1
    }

    /// Sums of values over `cells` shifted by (dx, dy) cells, and by multiples of 2ᵏ cells more in both directions: exact on level 0, on
    /// level k upper bounds for all shifts of up to 2ᵏ - 1 cells more. Stops early, with some values below `enough`, when `enough` is
    /// out of reach for all.
    ///
    /// What a cell adds to sums beside each other is side by side in memory.
    #[inline]
    pub(super) fn sums<const COLUMNS: usize, const ROWS: usize>(
        &self,
        level: usize,
        cells: &[(i16, i16)],
        dx: i32,
        dy: i32,
        enough: u32,
    ) -> [[u32; COLUMNS]; ROWS] {
        let Level { width, height, values } = &self.levels[level];
        // Pooled levels hold one more column and row in front: squares that begin outside and reach in.
        let pad = i32::from(level > 0);
        let (dx, dy) = (dx - self.origin_column, dy - self.origin_row);
        let mut sums = [[0_u32; COLUMNS]; ROWS];
        let mut left = cells.len() as u32;
        for chunk in cells.chunks(CHUNK) {
            let mut parts = [[0_u16; COLUMNS]; ROWS];
            for &(x, y) in chunk {
                // Wrapped numbers are outside, as all others that are too large.
                let column = (i32::from(x).wrapping_add(dx) >> level).wrapping_add(pad);
                let row = (i32::from(y).wrapping_add(dy) >> level).wrapping_add(pad);
                for (k, part) in (0..).zip(&mut parts) {
                    let row = row.wrapping_add(k) as usize;
                    if row < *height {
                        let seen = seen::<COLUMNS>(&values[row * width..][..*width], column);
                        part.iter_mut()
                            .zip(seen)
                            .for_each(|(part, value)| *part = part.wrapping_add(value.into()));
                    }
                }
            }
            for (sum, part) in sums.iter_mut().flatten().zip(parts.iter().flatten()) {
                *sum += u32::from(*part);
            }
            left -= chunk.len() as u32;
            if sums.iter().flatten().all(|sum| sum + 255 * left < enough) {
                return sums;
            }
        }
        sums
    }
}

/// Values beside each other in a row, from a column on; those outside are 0.
#[inline]
fn seen<const COLUMNS: usize>(row: &[u8], column: i32) -> [u8; COLUMNS] {
    let inside = row.get(column as usize..).and_then(|row| row.first_chunk());
    inside.copied().unwrap_or_else(|| {
        std::array::from_fn(|k| row.get(column.wrapping_add(k as i32) as usize).copied().unwrap_or(0))
    })
}

/// exp(-d²/2σ²) as a byte, by squared distance.
fn influence_table() -> Vec<u8> {
    let farthest = 2.0 * (f64::from(REACH) + 1.0) * (f64::from(REACH) + 1.0) * CELL_M * CELL_M;
    let steps = (farthest * STEPS_PER_M2) as usize + 1;
    let value = |i: usize| exp(-(i as f64 / STEPS_PER_M2) / (2.0 * SIGMA_M * SIGMA_M));
    (0..steps).map(|i| (255.0 * value(i)).round() as u8).collect()
}

/// Raises the cells around a point to its influence on their centres.
fn spread(level: &mut Level, table: &[u8], point: (f64, f64), cell: (i32, i32), origin: (i32, i32)) {
    for row in cell.1 - REACH..=cell.1 + REACH {
        let dy = (f64::from(row) + 0.5) * CELL_M - point.1;
        let start = (row - origin.1) as usize * level.width;
        for column in cell.0 - REACH..=cell.0 + REACH {
            let dx = (f64::from(column) + 0.5) * CELL_M - point.0;
            let value = table[((dx * dx + dy * dy) * STEPS_PER_M2) as usize];
            let entry = &mut level.values[start + (column - origin.0) as usize];
            *entry = value.max(*entry);
        }
    }
}

/// The next coarser level of `fine`, which is the finest when `first`.
fn pooled(fine: &Level, first: bool) -> Level {
    let finer_pad = usize::from(!first);
    let (width, height) =
        ((fine.width - finer_pad).div_ceil(2) + 1, (fine.height - finer_pad).div_ceil(2) + 1);
    let mut coarse = Level { width, height, values: vec![0; width * height] };
    // Entry c of the coarse level starts at fine index 2(c - 1) and spans 4 finest cells, or 3 finer entries,
    // which themselves overlap.
    let span = if first { 4 } else { 3 };
    let at = |i: usize, k: usize, size: usize| {
        let fine = (2 * i + k + finer_pad).checked_sub(2)?;
        (fine < size).then_some(fine)
    };
    for row in 0..height {
        for column in 0..width {
            let mut most = 0;
            for y in (0..span).filter_map(|k| at(row, k, fine.height)) {
                for x in (0..span).filter_map(|k| at(column, k, fine.width)) {
                    most = most.max(fine.values[y * fine.width + x]);
                }
            }
            coarse.values[row * width + column] = most;
        }
    }
    coarse
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sum(field: &PooledField, level: usize, cells: &[(i16, i16)], dx: i32, dy: i32) -> u32 {
        field.sums::<1, 1>(level, cells, dx, dy, 0)[0][0]
    }

    proptest! {
        #[test]
        fn a_level_bounds_all_shifts_within_its_stride(
            points in prop::collection::vec((-5.0..5.0f64, -5.0..5.0f64), 1..40),
            x in -80i16..80, y in -80i16..80, level in 1usize..=LEVELS, sx in 0i32..128, sy in 0i32..128,
        ) {
            let field = PooledField::new(&points);
            let stride = 1 << level;
            let bound = sum(&field, level, &[(x, y)], 0, 0);
            let exact = sum(&field, 0, &[(x, y)], sx % stride, sy % stride);
            prop_assert!(exact <= bound, "{exact} > {bound}");
            // Beside each other they are what each is alone.
            let together = field.sums::<8, 2>(level, &[(x, y), (y, x)], sx, sy, 0);
            for (row, column) in (0..2).flat_map(|row| (0..8).map(move |column| (row, column))) {
                let alone = sum(&field, level, &[(x, y), (y, x)], sx + stride * column, sy + stride * row);
                prop_assert_eq!(together[row as usize][column as usize], alone);
            }
        }
    }

    #[test]
    fn is_high_on_a_point_and_zero_far_from_it() {
        let field = PooledField::new(&[(0.05, 0.05), (3.0, 3.0)]);
        assert_eq!(sum(&field, 0, &[(0, 0)], 0, 0), 255);
        assert_eq!(sum(&field, 0, &[(10, 0)], 0, 0), 0);
        assert_eq!(sum(&field, 0, &[(0, 0), (10, 0), (-2000, 7)], 0, 0), 255);
    }
}
