//! The sums of Gauss–Newton over many points, several points at a time: each step of the arithmetic runs over a whole
//! batch, so that the processor's wide instructions can be used on every machine, with the same bits. A place on the grid needs double
//! precision; what is within a cell, and what only weighs, does not.

use crate::field::ScoreRead;
use flockslam_evidence::CellIndex;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use nalgebra::{Matrix3, Vector3};

/// Points in a batch.
pub(crate) const BATCH: usize = 16;
/// Partial sums that are added to at once.
const LANES: usize = 4;
/// Adding this rounds a number to a whole one, which then stands in the low bits (1.5 · 2⁵²).
pub(crate) const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// The full score in the field's own units.
const FULL: f64 = u16::MAX as f64;
/// The same, for the arithmetic within a batch.
const FULL_SCORE: f32 = u16::MAX as f32;

type Row<T> = [T; BATCH];

/// Where the points of a batch end, and the scores around each; lengths are sides of a cell.
#[derive(Default)]
pub(crate) struct Batch {
    /// Points turned into the field's directions.
    x: Row<f32>,
    y: Row<f32>,
    /// Column and row of the block's first cell, in the low bits.
    column: Row<u64>,
    row: Row<u64>,
    /// Way from the centre of the block's first cell, 0 … 1.
    along: Row<f32>,
    up: Row<f32>,
    /// Scores of the cells (0, 0), (1, 0), (0, 1), (1, 1) of the block.
    blocks: [Row<i32>; 4],
}

impl Batch {
    /// Turns the points by `turn` (cosine and sine, per metre of a cell's side) and finds their blocks after a shift.
    #[inline]
    pub(crate) fn place(&mut self, points: &Row<Point>, turn: (f64, f64), shift: (f64, f64)) {
        for (k, point) in points.iter().enumerate() {
            let x = turn.0 * point.x_m - turn.1 * point.y_m;
            let y = turn.1 * point.x_m + turn.0 * point.y_m;
            (self.column[k], self.along[k]) = split(x + shift.0);
            (self.row[k], self.up[k]) = split(y + shift.1);
            (self.x[k], self.y[k]) = (x as f32, y as f32);
        }
    }

    /// Reads the blocks of the first `count` points; the others count as a perfect fit without information.
    #[inline]
    pub(crate) fn read(&mut self, read: &mut impl ScoreRead, count: usize) {
        for k in 0..BATCH {
            let block = if k < count {
                read.block(CellIndex::new(self.column[k] as i32, self.row[k] as i32))
            } else {
                [u16::MAX; 4]
            };
            for (row, score) in self.blocks.iter_mut().zip(block) {
                row[k] = i32::from(score);
            }
        }
    }
}

/// Splits a number into the greatest whole number not above it, in the low bits, and the rest. (A number that is whole may come apart as one
/// less and a rest of 1; interpolation gives the same for both.)
#[inline]
fn split(number: f64) -> (u64, f32) {
    let rounded = (number - 0.5) + ROUNDER;
    (rounded.to_bits(), (number - (rounded - ROUNDER)) as f32)
}

/// One point of the linearised problem, in sides of a cell and units of the score: the slope of the score along x, along y and as the
/// robot turns, and what is missing to the full score.
struct Linearised {
    x: f32,
    y: f32,
    t: f32,
    r: f32,
}

impl Batch {
    /// Bilinear interpolation M of point `k` with its true derivative, residual 1 - M.
    #[inline]
    fn linearised(&self, k: usize) -> Linearised {
        let [m00, m10, m01, m11] = &self.blocks;
        let (a, b) = (self.along[k], self.up[k]);
        // Scores have 16 bits: single precision holds them and their differences.
        let [low, high] =
            [m10[k].wrapping_sub(m00[k]), m11[k].wrapping_sub(m01[k])].map(|score| score as f32);
        let (bottom, top) = (m00[k] as f32 + a * low, m01[k] as f32 + a * high);
        let (x, y) = (low + b * (high - low), top - bottom);
        let r = FULL_SCORE - (bottom + b * y);
        Linearised { x, y, t: self.x[k] * y - self.y[k] * x, r }
    }
}

/// Sums over batches, in sides of a cell and units of the score.
#[derive(Default)]
pub(crate) struct Sums {
    xx: [f32; LANES],
    xy: [f32; LANES],
    xt: [f32; LANES],
    yy: [f32; LANES],
    yt: [f32; LANES],
    tt: [f32; LANES],
    xr: [f32; LANES],
    yr: [f32; LANES],
    tr: [f32; LANES],
    r: [f32; LANES],
    rr: [f32; LANES],
}

impl Sums {
    /// Adds the points of a batch.
    #[inline]
    pub(crate) fn add(&mut self, batch: &Batch) {
        for first in (0..BATCH).step_by(LANES) {
            for lane in 0..LANES {
                let Linearised { x, y, t, r } = batch.linearised(first + lane);
                self.xx[lane] += x * x;
                self.xy[lane] += x * y;
                self.xt[lane] += x * t;
                self.yy[lane] += y * y;
                self.yt[lane] += y * t;
                self.tt[lane] += t * t;
                self.xr[lane] += x * r;
                self.yr[lane] += y * r;
                self.tr[lane] += t * r;
                self.r[lane] += r;
                self.rr[lane] += r * r;
            }
        }
    }

    /// The equations in metres and shares of the full score, over this many points.
    pub(crate) fn in_metres(&self, per_metre: f64, points: usize) -> NormalEquations {
        let sum = |lanes: [f32; LANES]| lanes.into_iter().map(f64::from).sum::<f64>();
        let (one, length) = (1.0 / FULL, per_metre / FULL);
        let [xx, xy, yy] = [self.xx, self.xy, self.yy].map(|s| length * length * sum(s));
        let [xt, yt] = [self.xt, self.yt].map(|s| length * one * sum(s));
        let tt = one * one * sum(self.tt);
        NormalEquations {
            hessian: Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt),
            gradient: Vector3::new(
                length * one * sum(self.xr),
                length * one * sum(self.yr),
                one * one * sum(self.tr),
            ),
            score: points as f64 - one * sum(self.r),
            squares: one * one * sum(self.rr),
        }
    }
}

/// Sums over all points of the linearised problem, not yet divided by their number.
pub(crate) struct NormalEquations {
    pub(crate) hessian: Matrix3<f64>,
    pub(crate) gradient: Vector3<f64>,
    pub(crate) score: f64,
    pub(crate) squares: f64,
}

impl NormalEquations {
    pub(crate) fn of(read: &mut impl ScoreRead, points: &[Point], pose: Pose) -> Self {
        let per_metre = 1.0 / read.cell_size_m();
        let mut sums = Sums::default();
        for_each_batch(read, points, pose, |batch, _| sums.add(batch));
        sums.in_metres(per_metre, points.len())
    }
}

/// Reads the scores around the ends of all points, batch by batch; `add` gets each batch and the number of its first point.
#[inline]
fn for_each_batch(
    read: &mut impl ScoreRead,
    points: &[Point],
    pose: Pose,
    mut add: impl FnMut(&Batch, usize),
) {
    let per_metre = 1.0 / read.cell_size_m();
    let (sin, cos) = sin_cos(pose.heading_rad);
    let turn = (cos * per_metre, sin * per_metre);
    let shift = (pose.x_m * per_metre - 0.5, pose.y_m * per_metre - 0.5);
    let mut batch = Batch::default();
    let mut rest = [Point::default(); BATCH];
    for (number, points) in points.chunks(BATCH).enumerate() {
        let whole = points.try_into().unwrap_or_else(|_| {
            rest[..points.len()].copy_from_slice(points);
            &rest
        });
        batch.place(whole, turn, shift);
        batch.read(read, points.len());
        add(&batch, number * BATCH);
    }
}

/// The same sums of points that were measured one after the other: those of the pose, those times the seconds of each point, and those
/// times their square.
#[derive(Default)]
struct TimedSums {
    /// xx, xy, xt, yy, yt, tt.
    squares: [[[f32; LANES]; 6]; 3],
    /// xr, yr, tr.
    missed: [[[f32; LANES]; 3]; 2],
    rr: [f32; LANES],
}

impl TimedSums {
    #[inline]
    fn add(&mut self, batch: &Batch, times_s: &Row<f64>) {
        for first in (0..BATCH).step_by(LANES) {
            for lane in 0..LANES {
                let Linearised { x, y, t, r } = batch.linearised(first + lane);
                let time_s = times_s[first + lane] as f32;
                let products = [x * x, x * y, x * t, y * y, y * t, t * t];
                for (i, product) in products.into_iter().enumerate() {
                    self.squares[0][i][lane] += product;
                    self.squares[1][i][lane] += product * time_s;
                    self.squares[2][i][lane] += product * (time_s * time_s);
                }
                for (i, slope) in [x, y, t].into_iter().enumerate() {
                    self.missed[0][i][lane] += slope * r;
                    self.missed[1][i][lane] += slope * r * time_s;
                }
                self.rr[lane] += r * r;
            }
        }
    }
}

/// The linearised problem in pose and velocity: sums over all points, not yet divided by their number, in metres and shares of the
/// full score.
pub(crate) struct TimedEquations {
    /// Jᵀ J of the pose, weighted by 1, by the seconds of each point, and by their square.
    pub(crate) blocks: [Matrix3<f64>; 3],
    /// Jᵀ r, weighted by 1 and by the seconds.
    pub(crate) gradients: [Vector3<f64>; 2],
    /// Squared residuals.
    pub(crate) squares: f64,
}

impl TimedEquations {
    /// Of points (metres, frame of the robot), each measured so many seconds after the stamp, at a pose.
    pub(crate) fn of(read: &mut impl ScoreRead, points: &[Point], times_s: &[f64], pose: Pose) -> Self {
        assert_eq!(points.len(), times_s.len());
        let per_metre = 1.0 / read.cell_size_m();
        let (mut sums, mut rest) = (TimedSums::default(), [0.0; BATCH]);
        for_each_batch(read, points, pose, |batch, first| {
            let times_s = &times_s[first..(first + BATCH).min(times_s.len())];
            let whole = times_s.try_into().unwrap_or_else(|_| {
                rest[..times_s.len()].copy_from_slice(times_s);
                &rest
            });
            sums.add(batch, whole);
        });
        let (one, length) = (1.0 / FULL, per_metre / FULL);
        let sum = |lanes: [f32; LANES]| lanes.into_iter().map(f64::from).sum::<f64>();
        let blocks = sums.squares.map(|squares| {
            let [xx, xy, xt, yy, yt, tt] = squares.map(sum);
            let (both, mixed, turn) = (length * length, length * one, one * one);
            let (xx, xy, yy) = (both * xx, both * xy, both * yy);
            let (xt, yt) = (mixed * xt, mixed * yt);
            Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, turn * tt)
        });
        let gradients = sums.missed.map(|missed| {
            let [xr, yr, tr] = missed.map(sum);
            Vector3::new(length * one * xr, length * one * yr, one * one * tr)
        });
        Self { blocks, gradients, squares: one * one * sum(sums.rr) }
    }
}
