//! Surfaces around a robot as normal distributions of the points of its last scans. Takes points and a predicted pose with its
//! covariance, gives the pose that explains both.

use crate::cloud::Placement;
use flockslam_evidence::floor;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose, wrap_angle};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use std::collections::VecDeque;
use zerocopy::FromZeros;

/// Units in a metre of the fixed-point coordinates: two millimetres each.
const UNITS_PER_M: f64 = 500.0;
/// Side of a cell in units: half a metre. A surface 30 m away is met every half metre by beams that are 1° apart.
const CELL_UNITS: i32 = 250;
/// Cells along a side of the torus, a power of two: 256 m.
pub(crate) const SIDE: i32 = 512;
/// Cells along the sides of a block, which is stored in one piece, so that memory is touched only near points.
const BLOCK: (i32, i32) = (16, 8);
/// Travel over which scans are held, metres: from so far back things ahead have been seen.
const WINDOW_M: f64 = 50.0;
/// Scans that are held at most: a bound on memory while a robot turns without travel.
const SCANS_MAX: usize = 400;
/// Points from farther away are not used, metres: two such points in the window share no cell of the torus.
pub const SURFACE_RANGE_MAX_M: f64 = 80.0;
/// Fewest points, weighted by their distance, of which a distribution is made.
const POINTS_MIN: f64 = 4.0;
/// Added to the covariance of each distribution, a standard deviation in metres: the error of ranges.
const RANGE_SIGMA_M: f64 = 0.03;
/// A surface as wide as a cell ends where the cells end, or where it is not yet seen: only what is narrower than this standard
/// deviation, metres, says where it is.
const EXTENT_M: f64 = 0.25;
/// Squared standard deviations at which a point loses three quarters of its weight.
const FAR_SQUARED: f64 = 9.0;
/// Cost of a point that meets no surface.
const UNKNOWN_COST: f64 = 0.5 * FAR_SQUARED / SHARED_ERROR;
/// Points in the same cell share its error: the variance is this many times greater.
const SHARED_ERROR: f64 = 2.0;
/// Gauss–Newton steps at most, and the step from which on the fit has converged, metres and radians.
const STEPS: usize = 12;
const CONVERGED: (f64, f64) = (1e-3, 5e-5);
/// Least information of a scan by itself, per m² and per rad²: what the scan does not determine stays where it is.
const LEAST_INFORMATION: (f64, f64) = (11.0, 44.0);

/// A cell and the eight around it, as rows and columns from it.
const NEIGHBOURS: [(i32, i32); 9] =
    [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 0), (0, 1), (1, -1), (1, 0), (1, 1)];

/// Zeroth, first and second moments of the points in a cell, about its centre, in units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, FromZeros)]
struct Moments {
    count: i32,
    x: i32,
    y: i32,
    xx: i32,
    xy: i32,
    yy: i32,
}

/// Points of a scan, in units.
#[derive(Clone, Debug, Default)]
struct HeldScan {
    travel_m: f64,
    points: Vec<(i32, i32)>,
}

/// Normal distributions of the points of the last scans, over 50 m of travel, in cells of half a metre (Biber and Straßer 2003),
/// blended over the neighbouring cells.
///
/// Where points repeat, a distribution is narrow and holds a scan firmly. Leaves, and ground that tilts in and out of sight, give
/// wide ones, which hold it little: what a point is worth follows from how well its place repeats.
#[derive(Debug)]
pub struct SurfaceMap {
    cells: Vec<Moments>,
    held: VecDeque<HeldScan>,
    /// Buffers of scans that are held no longer.
    spare: Vec<Vec<(i32, i32)>>,
    travel_m: f64,
    last: Option<Pose>,
}

/// A pose that explains a scan and a prediction.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceFit {
    /// Frame of the map from the frame of the points.
    pub pose: Pose,
    /// The pose that the points alone give near it.
    pub alone: Pose,
    /// Information of the points alone (per m², m·rad and rad²).
    pub information: Matrix3<f64>,
    /// Sum of the weights of the points over their number: 1 when all lie on known surfaces.
    pub inliers: f64,
    /// Negative logarithm of the likelihood of the points, up to a constant.
    pub cost: f64,
    /// The same of the pose by its prediction.
    pub prior_cost: f64,
}

/// How well a pose explains a scan and a prediction.
#[derive(Clone, Copy, Debug)]
pub struct Explained {
    /// Frame of the map from the frame of the points.
    pub pose: Pose,
    /// Negative logarithm of the likelihood of the points and of the pose, up to a constant.
    pub cost: f64,
    /// Sum of the weights of the points.
    pub weights: f64,
}

/// Where a scan is expected: the pose, and the information of the prediction.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePrior {
    /// The predicted pose.
    pub pose: Pose,
    /// Inverse of its covariance.
    pub information: Matrix3<f64>,
}

impl Default for SurfaceMap {
    fn default() -> Self {
        // Zeroed memory takes no room before it is written to; most of it never is.
        let cells = Moments::new_vec_zeroed((SIDE * SIDE) as usize);
        Self {
            cells: cells.expect("there is memory for a few megabytes"),
            held: VecDeque::new(),
            spare: Vec::new(),
            travel_m: 0.0,
            last: None,
        }
    }
}

/// Sums over the points at one pose.
struct Sums {
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
    weights: f64,
    cost: f64,
}

impl SurfaceMap {
    /// Clears all scans.
    pub fn clear(&mut self) {
        while self.withdraw_oldest() {}
        (self.travel_m, self.last) = (0.0, None);
    }

    /// Whether no scan is held.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// Adds a scan whose points (metres, frame of the robot) were seen from `pose`; scans far back are withdrawn.
    pub fn add(&mut self, pose: Pose, points: &[Point]) {
        self.travel_m += self.last.map_or(0.0, |last| last.distance_m(pose));
        self.last = Some(pose);
        while self.held.len() >= SCANS_MAX
            || self.held.front().is_some_and(|oldest| self.travel_m - oldest.travel_m > WINDOW_M)
        {
            self.withdraw_oldest();
        }
        let mut kept = self.spare.pop().unwrap_or_default();
        kept.clear();
        let placed = Placement::from(pose);
        kept.extend(points.iter().map(|point| {
            let (x_m, y_m) = placed.apply(point.x_m, point.y_m);
            (units(x_m), units(y_m))
        }));
        self.change(&kept, 1);
        self.held.push_back(HeldScan { travel_m: self.travel_m, points: kept });
    }

    fn withdraw_oldest(&mut self) -> bool {
        let Some(HeldScan { points, .. }) = self.held.pop_front() else { return false };
        self.change(&points, -1);
        self.spare.push(points);
        true
    }

    fn change(&mut self, points: &[(i32, i32)], sign: i32) {
        for (x, y) in points {
            let (column, row) = (x.div_euclid(CELL_UNITS), y.div_euclid(CELL_UNITS));
            let (dx, dy) = (x - column * CELL_UNITS - CELL_UNITS / 2, y - row * CELL_UNITS - CELL_UNITS / 2);
            let cell = &mut self.cells[index(column, row)];
            // Sums wrap in either direction alike: what is withdrawn leaves no trace however many points a cell holds.
            cell.count = cell.count.wrapping_add(sign);
            cell.x = cell.x.wrapping_add(sign * dx);
            cell.y = cell.y.wrapping_add(sign * dy);
            cell.xx = cell.xx.wrapping_add(sign * dx * dx);
            cell.xy = cell.xy.wrapping_add(sign * dx * dy);
            cell.yy = cell.yy.wrapping_add(sign * dy * dy);
        }
    }

    /// The pose that explains the points (metres, frame of the robot) and the prediction best, found from the predicted pose by
    /// Gauss–Newton with the kernel of Geman and McClure (1987); `None` when no point meets a surface.
    pub fn fit(&self, points: &[Point], prior: &SurfacePrior) -> Option<SurfaceFit> {
        let mut pose = prior.pose;
        for _ in 0..STEPS {
            let sums = self.sums(points, pose);
            let pulled = prior.information * difference(prior.pose, pose) + sums.gradient;
            let factor = (sums.information + prior.information).cholesky()?;
            let step = -factor.solve(&pulled);
            pose = moved(pose, step);
            if step.xy().norm() < CONVERGED.0 && step.z.abs() < CONVERGED.1 {
                break;
            }
        }
        let sums = self.sums(points, pose);
        let off = difference(prior.pose, pose);
        let (least_m, least_rad) = LEAST_INFORMATION;
        let least = Matrix3::from_diagonal(&Vector3::new(least_m, least_m, least_rad));
        let step = -(sums.information + least).cholesky()?.solve(&sums.gradient);
        (sums.weights > 0.0).then(|| SurfaceFit {
            pose,
            alone: moved(pose, step),
            information: sums.information,
            inliers: sums.weights / points.len() as f64,
            cost: sums.cost,
            prior_cost: 0.5 * off.dot(&(prior.information * off)),
        })
    }

    /// As [`Self::fit`], but points that meet no surface are explained as well: badly.
    pub fn explained(&self, points: &[Point], prior: &SurfacePrior) -> Explained {
        match self.fit(points, prior) {
            Some(fit) => Explained {
                pose: fit.pose,
                cost: fit.cost + fit.prior_cost,
                weights: fit.inliers * points.len() as f64,
            },
            None => Explained { pose: prior.pose, cost: UNKNOWN_COST * points.len() as f64, weights: 0.0 },
        }
    }

    /// Calls `visit` with the column and the row, on the torus, of each cell with points, and their number; with some cells more than once.
    pub(crate) fn for_each_count(&self, mut visit: impl FnMut(i32, i32, i32)) {
        for (x, y) in self.held.iter().flat_map(|scan| &scan.points) {
            let (column, row) = (x.div_euclid(CELL_UNITS), y.div_euclid(CELL_UNITS));
            visit(column & (SIDE - 1), row & (SIDE - 1), self.cells[index(column, row)].count);
        }
    }

    /// Sum of the weights of the points at a pose over their number, as [`SurfaceFit::inliers`]; there must be a point.
    pub fn inliers_at(&self, points: &[Point], pose: Pose) -> f64 {
        self.sums(points, pose).weights / points.len() as f64
    }

    fn sums(&self, points: &[Point], pose: Pose) -> Sums {
        // The same bits on every machine.
        let (sin, cos) = sin_cos(pose.heading_rad);
        let mut sums =
            Sums { information: Matrix3::zeros(), gradient: Vector3::zeros(), weights: 0.0, cost: 0.0 };
        for point in points {
            let (rx, ry) = (cos * point.x_m - sin * point.y_m, sin * point.x_m + cos * point.y_m);
            let Some((mean, inverse)) = self.surface(pose.x_m + rx, pose.y_m + ry) else {
                sums.cost += UNKNOWN_COST;
                continue;
            };
            let off = Vector2::new(pose.x_m + rx, pose.y_m + ry) - mean;
            let pulled = inverse * off;
            let squared = off.dot(&pulled);
            let near = 1.0 / (1.0 + squared / FAR_SQUARED);
            let weight = near * near;
            sums.weights += weight;
            sums.cost += 0.5 * squared * near / SHARED_ERROR;
            let weight = weight / SHARED_ERROR;
            let (across_x, across_y) =
                (inverse.m12 * rx - inverse.m11 * ry, inverse.m22 * rx - inverse.m12 * ry);
            let h = &mut sums.information;
            h[(0, 0)] += weight * inverse.m11;
            h[(0, 1)] += weight * inverse.m12;
            h[(1, 1)] += weight * inverse.m22;
            h[(0, 2)] += weight * across_x;
            h[(1, 2)] += weight * across_y;
            h[(2, 2)] += weight * (across_y * rx - across_x * ry);
            sums.gradient += Vector3::new(pulled.x, pulled.y, pulled.y * rx - pulled.x * ry) * weight;
        }
        sums.information.fill_lower_triangle_with_upper_triangle();
        sums
    }

    /// Mean of the surface at (x, y) metres and the information of a point on it, blended from the nine cells around.
    fn surface(&self, x_m: f64, y_m: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let cell_m = f64::from(CELL_UNITS) / UNITS_PER_M;
        let (u, v) = (x_m / cell_m, y_m / cell_m);
        let (column, row) = (floor(u), floor(v));
        // Moments about the middle of the middle cell, in units.
        let [mut n, mut x, mut y, mut xx, mut xy, mut yy] = [0.0; 6];
        let nearness =
            |position: f64, at: i32| (1.5 - (position - 0.5 - f64::from(at)).abs()).clamp(0.0, 1.0);
        let around = [-1, 0, 1];
        let (across, along) =
            (around.map(|dc| nearness(u, column + dc)), around.map(|dr| nearness(v, row + dr)));
        for (dr, dc) in NEIGHBOURS {
            let cell = &self.cells[index(column + dc, row + dr)];
            if cell.count <= 0 {
                continue;
            }
            let weight = across[(dc + 1) as usize] * along[(dr + 1) as usize];
            let [count, cx, cy, cxx, cxy, cyy] =
                [cell.count, cell.x, cell.y, cell.xx, cell.xy, cell.yy].map(f64::from);
            let (ox, oy) = (f64::from(dc * CELL_UNITS), f64::from(dr * CELL_UNITS));
            n += weight * count;
            x += weight * (cx + count * ox);
            y += weight * (cy + count * oy);
            xx += weight * (cxx + 2.0 * ox * cx + count * ox * ox);
            xy += weight * (cxy + ox * cy + oy * cx + count * ox * oy);
            yy += weight * (cyy + 2.0 * oy * cy + count * oy * oy);
        }
        if n < POINTS_MIN {
            return None;
        }
        let (mx, my) = (x / n, y / n);
        let scale = 1.0 / (UNITS_PER_M * UNITS_PER_M);
        let floor_m2 = RANGE_SIGMA_M * RANGE_SIGMA_M;
        let (a, b, c) = (
            (xx / n - mx * mx) * scale + floor_m2,
            (xy / n - mx * my) * scale,
            (yy / n - my * my) * scale + floor_m2,
        );
        let determinant = a * c - b * b;
        let middle = |at: i32| (f64::from(at) + 0.5) * cell_m;
        let mean = Vector2::new(middle(column) + mx / UNITS_PER_M, middle(row) + my / UNITS_PER_M);
        // Sums that have wrapped make no covariance.
        (determinant > 0.0 && a > 0.0)
            .then(|| (mean, located(Matrix2::new(c, -b, -b, a) * (1.0 / determinant))))
    }
}

/// The inverse covariance of a surface without the part of its extent: both eigenvalues reduced by that of [`EXTENT_M`], at least 0.
fn located(inverse: Matrix2<f64>) -> Matrix2<f64> {
    let extent = EXTENT_M.powi(-2);
    let (middle, half) = (0.5 * (inverse.m11 + inverse.m22), 0.5 * (inverse.m11 - inverse.m22));
    let apart = (half * half + inverse.m12 * inverse.m12).sqrt();
    let (large, small) = ((middle + apart - extent).max(0.0), (middle - apart - extent).max(0.0));
    let mean = 0.5 * (large + small);
    let share = if apart > 0.0 { 0.5 * (large - small) / apart } else { 0.0 };
    let (half, mixed) = (share * half, share * inverse.m12);
    Matrix2::new(mean + half, mixed, mixed, mean - half)
}

/// How far a pose is from another, metres and radians.
fn difference(from: Pose, to: Pose) -> Vector3<f64> {
    Vector3::new(to.x_m - from.x_m, to.y_m - from.y_m, wrap_angle(to.heading_rad - from.heading_rad))
}

fn moved(pose: Pose, step: Vector3<f64>) -> Pose {
    Pose::new(pose.x_m + step.x, pose.y_m + step.y, pose.heading_rad + step.z)
}

#[inline]
fn units(metres: f64) -> i32 {
    // Two thousand kilometres away all cells are one; nothing overflows.
    floor((metres * UNITS_PER_M).clamp(-1e9, 1e9))
}

/// The number of the cell, along one axis, of a coordinate in metres.
pub(crate) fn cell(metres: f64) -> i32 {
    units(metres).div_euclid(CELL_UNITS)
}

#[inline]
fn index(column: i32, row: i32) -> usize {
    let (column, row) = (column & (SIDE - 1), row & (SIDE - 1));
    let block = row / BLOCK.1 * (SIDE / BLOCK.0) + column / BLOCK.0;
    (block * BLOCK.0 * BLOCK.1 + row % BLOCK.1 * BLOCK.0 + column % BLOCK.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walls and a few trees, seen from `at` by beams that are one degree apart.
    fn scan(at: Pose) -> Vec<Point> {
        let walls = (0..60).map(|i| Point::new(-15.0 + 0.5 * f64::from(i), 20.0));
        let sides = (0..40).map(|i| Point::new(18.0, -10.0 + 0.5 * f64::from(i)));
        let trees = [(3.0, 9.0), (-6.0, 5.0), (9.0, -8.0)].map(|(x, y)| Point::new(x, y));
        walls.chain(sides).chain(trees).map(|point| at.inverse().apply(point)).collect()
    }

    fn driven() -> SurfaceMap {
        let mut map = SurfaceMap::default();
        for k in 0..20 {
            let pose = Pose::new(0.23 * f64::from(k), 0.1 * f64::from(k % 3), 0.0);
            // Beams meet the walls elsewhere each time.
            let shifted = Pose::new(0.03 * f64::from(k % 7), 0.0, 0.0);
            let points: Vec<Point> = scan(Pose::IDENTITY)
                .iter()
                .map(|point| if point.y_m > 19.0 { shifted.apply(*point) } else { *point })
                .map(|point| pose.inverse().apply(point))
                .collect();
            map.add(pose, &points);
        }
        map
    }

    fn prior(pose: Pose, sigma: (f64, f64)) -> SurfacePrior {
        let [xy, turn] = [sigma.0, sigma.1].map(|sigma: f64| sigma.powi(-2));
        SurfacePrior { pose, information: Matrix3::from_diagonal(&Vector3::new(xy, xy, turn)) }
    }

    #[test]
    fn a_scan_of_sparse_points_is_fitted_to_surfaces() {
        let (map, truth) = (driven(), Pose::new(4.8, 0.3, 0.05));
        let predicted = Pose::new(4.95, 0.15, 0.03);
        let fit = map.fit(&scan(truth), &prior(predicted, (0.3, 0.05))).unwrap();
        assert!(fit.pose.distance_m(truth) < 0.04 && fit.pose.turn_rad(truth) < 0.004, "{fit:?}");
        assert!(fit.inliers > 0.8, "{fit:?}");
        let there = map.fit(&scan(truth), &prior(truth, (0.3, 0.05))).unwrap();
        assert!(there.cost <= fit.cost + 0.5, "{} {}", there.cost, fit.cost);
    }

    #[test]
    fn a_certain_prediction_is_kept_and_the_scan_alone_gives_another_pose() {
        let (map, truth) = (driven(), Pose::new(4.8, 0.3, 0.05));
        let predicted = Pose::new(4.9, 0.3, 0.05);
        let fit = map.fit(&scan(truth), &prior(predicted, (1e-4, 1e-4))).unwrap();
        assert!(fit.pose.distance_m(predicted) < 0.01, "{fit:?}");
        assert!(fit.alone.distance_m(truth) < fit.pose.distance_m(truth), "{fit:?}");
    }

    #[test]
    fn what_is_withdrawn_leaves_no_trace() {
        let mut map = driven();
        map.clear();
        assert!(map.is_empty() && map.cells.iter().all(|cell| *cell == Moments::default()));
        assert!(map.fit(&scan(Pose::IDENTITY), &prior(Pose::IDENTITY, (0.1, 0.1))).is_none());
    }

    #[test]
    fn scans_far_back_are_withdrawn() {
        let mut map = driven();
        map.add(Pose::new(200.0, 0.0, 0.0), &[Point::new(1.0, 0.0)]);
        assert_eq!(map.held.len(), 1);
    }
}
