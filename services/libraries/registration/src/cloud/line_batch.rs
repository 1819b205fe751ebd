//! Points of a scan with the lines near them, several at a time: takes a pose, the points and the moments of a submap, and gives the sums of
//! a Gauss–Newton step on the distances of the points to their lines.
//!
//! Each step of the arithmetic runs over a whole batch, so that the processor's wide instructions can be used on every machine, with the
//! same bits. What is near a cell's centre, and what only weighs, is small enough for single precision.

use super::{MomentGrid, PackedPoint, Placement};
use crate::batch::{BATCH, ROUNDER};
use zerocopy::FromZeros;

/// Partial sums that are added to at once.
const LANES: usize = 4;
/// Cells in a millimetre.
const CELLS_PER_MM: f64 = 1e-3 / MomentGrid::CELL_M;
/// Cosine to the normal from which on it is clear which face of a wall is seen.
const FACING_MIN: f32 = 0.1;
/// Flatness from which on a line is a face of a wall; less is a corner, which has no sides.
const FLAT_MIN: f32 = 0.8;

type Row<T> = [T; BATCH];

/// Which points count, and how much.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weighing {
    /// Points farther from their line than this do not count, metres.
    pub(super) gate_m: f64,
    /// Scale of the Cauchy kernel, metres.
    pub(super) kernel_m: f64,
}

/// Sums over the points at one pose.
#[derive(Clone, Copy, Default)]
pub(super) struct Sums {
    /// `Σ w J Jᵀ`, upper triangle (xx, xy, xθ, yy, yθ, θθ): translation in the grid's axes, metres, and rotation about the robot, radians.
    pub(super) h: [f64; 6],
    /// `Σ w J d` of the distances to the lines.
    pub(super) g: [f64; 3],
    /// Points that count.
    pub(super) inliers: u32,
    /// Sum of their squared distances, m².
    pub(super) squared: f64,
}

/// Points of a batch at their places, and the line near each.
#[derive(Default)]
struct LineBatch {
    /// Points turned into the grid's directions, metres.
    along_x: Row<f32>,
    along_y: Row<f32>,
    /// Column and row of the cell, in the low bits.
    column: Row<u64>,
    row: Row<u64>,
    /// From the cell's centre, metres.
    dx: Row<f32>,
    dy: Row<f32>,
    lines: Row<LocalLine>,
}

/// The line near a point. Without evidence for one all is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromZeros)]
pub(super) struct LocalLine {
    /// A point on it, from the centre of a cell, metres.
    pub(super) x_m: f32,
    pub(super) y_m: f32,
    /// Unit normal; it points to where the line was seen from.
    pub(super) normal_x: f32,
    pub(super) normal_y: f32,
    /// 0 for a round blob … 1 for a thin line.
    pub(super) flatness: f32,
    /// Mean cosine between the normal and the way back to the lidar.
    pub(super) facing: f32,
}

/// Partial sums: xx, xy, xθ, yy, yθ, θθ; x, y, θ times the distance; inliers; squares.
type Partial = [[f32; LANES]; 11];

/// The sums over `points`, given in the robot's frame, with the robot at `at` in the grid's frame.
pub(super) fn sums(
    grid: &mut MomentGrid,
    points: &[PackedPoint],
    at: &Placement,
    weighing: Weighing,
) -> Sums {
    let mut batch = LineBatch::default();
    let mut partial: Partial = [[0.0; LANES]; 11];
    let mut rest = [PackedPoint::default(); BATCH];
    for points in points.chunks(BATCH) {
        let whole = points.try_into().unwrap_or_else(|_| {
            rest[..points.len()].copy_from_slice(points);
            &rest
        });
        batch.place(whole, at);
        batch.read(grid, points.len());
        batch.add_to(&mut partial, weighing);
    }
    let [xx, xy, xt, yy, yt, tt, xd, yd, td, inliers, squared] =
        partial.map(|lanes| lanes.into_iter().map(f64::from).sum::<f64>());
    Sums { h: [xx, xy, xt, yy, yt, tt], g: [xd, yd, td], inliers: inliers as u32, squared }
}

impl LineBatch {
    #[inline]
    fn place(&mut self, points: &Row<PackedPoint>, at: &Placement) {
        let (shift_x, shift_y) = (at.x_m / MomentGrid::CELL_M, at.y_m / MomentGrid::CELL_M);
        let cell_m = MomentGrid::CELL_M;
        let (cos, sin) = at.rotate(CELLS_PER_MM, 0.0);
        for (k, point) in points.iter().enumerate() {
            let (x_mm, y_mm) = (f64::from(point.x_mm), f64::from(point.y_mm));
            let (x, y) = (cos * x_mm - sin * y_mm, sin * x_mm + cos * y_mm);
            (self.along_x[k], self.along_y[k]) = ((x * cell_m) as f32, (y * cell_m) as f32);
            let (column, row) = ((x + shift_x - 0.5) + ROUNDER, (y + shift_y - 0.5) + ROUNDER);
            (self.column[k], self.row[k]) = (column.to_bits(), row.to_bits());
            // A point on the border of two cells may come to either.
            self.dx[k] = ((x + shift_x - 0.5 - (column - ROUNDER)) * cell_m) as f32;
            self.dy[k] = ((y + shift_y - 0.5 - (row - ROUNDER)) * cell_m) as f32;
        }
    }

    /// Reads the lines of the first `count` points; the others have none.
    #[inline]
    fn read(&mut self, grid: &mut MomentGrid, count: usize) {
        for k in 0..count {
            let (column, row) = (self.column[k] as i32, self.row[k] as i32);
            self.lines[k] = grid.local_line(column, row, self.dx[k], self.dy[k]);
        }
        self.lines[count..].fill(LocalLine::default());
    }

    #[inline]
    fn add_to(&self, partial: &mut Partial, weighing: Weighing) {
        let gate_m = weighing.gate_m as f32;
        let kernel = (1.0 / (weighing.kernel_m * weighing.kernel_m)) as f32;
        for first in (0..BATCH).step_by(LANES) {
            for lane in 0..LANES {
                let k = first + lane;
                let line = &self.lines[k];
                let (along_x, along_y) = (self.along_x[k], self.along_y[k]);
                let (x, y) = (line.normal_x, line.normal_y);
                let distance = x * (self.dx[k] - line.x_m) + y * (self.dy[k] - line.y_m);
                // A point that is seen from behind a face of a wall is on its other face.
                let behind = (x * along_x + y * along_y).max(0.0);
                let has_sides = (line.facing > FACING_MIN) & (line.flatness > FLAT_MIN);
                let clear = FACING_MIN * FACING_MIN * (along_x * along_x + along_y * along_y);
                let is_other_side = has_sides & (behind * behind > clear);
                let counts = (line.flatness > 0.0) & (distance.abs() <= gate_m) & !is_other_side;
                let one = if counts { 1.0 } else { 0.0 };
                let weight = one * line.flatness * line.flatness / (1.0 + distance * distance * kernel);
                let turn = y * along_x - x * along_y;
                let (wx, wy, wt) = (weight * x, weight * y, weight * turn);
                let terms = [
                    wx * x,
                    wx * y,
                    wx * turn,
                    wy * y,
                    wy * turn,
                    wt * turn,
                    wx * distance,
                    wy * distance,
                    wt * distance,
                    one,
                    one * distance * distance,
                ];
                for (sum, term) in partial.iter_mut().zip(terms) {
                    sum[lane] += term;
                }
            }
        }
    }
}
