//! Point-to-distribution matching (Biber and Straßer 2003; Trubin et al. 2020). Takes points, a field and a predicted
//! pose, gives the pose that makes the points most likely.

mod normal;
mod terms;

use crate::field::{ScoreField, ScoreRead};
use flockslam_evidence::{CellIndex, Level, floor};
use flockslam_geometry::elementary::{exp, hypot, sin_cos};
use flockslam_geometry::{Point, Pose};
use nalgebra::{Matrix3, Vector2, Vector3};
use normal::{Moments, Normal};
use serde::{Deserialize, Serialize};
use terms::{Terms, add_derivatives, newton_step};

/// Settings of [`Ndt`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NdtSettings {
    /// Side of an NDT cell, metres (rounded to a whole number of eight grid cells).
    pub cell_size_m: f64,
    /// Pull towards the distance from the pose before that the prediction has, whatever the direction, per m² and point: odometry
    /// measure the distance better than the direction.
    pub prior_travel: f64,
    /// Standard deviation of the direction of each beam for itself, radians: its end is blurred across the beam, so that of a wall
    /// seen at a grazing angle it has a small weight; and of a cell of few samples the mean is known no better than their spread allows.
    pub bearing_sigma_rad: f64,
}

impl Default for NdtSettings {
    fn default() -> Self {
        Self { cell_size_m: 0.36, prior_travel: 0.0, bearing_sigma_rad: 0.0 }
    }
}

/// Point-to-distribution matching (Biber & Straßer 2003; Trubin et al. 2020): the occupied cells of the field are gathered
/// into normal distributions on four grids that overlap by half a cell, and the pose that makes the points most likely is
/// found by Newton's method with the exact Hessian.
///
/// The plane is cut into blocks half an NDT cell wide; an NDT cell is any 2 × 2 blocks, so a point always is in four.
/// Distributions are made anew for each scan and only where points fall: that costs a few thousand reads, and nothing can
/// be stale.
#[derive(Clone, Debug, Default)]
pub struct Ndt {
    blocks: Vec<Slot<Moments>>,
    cells: Vec<Slot<Option<Normal>>>,
    /// Points of the scan in each block, at the pose that the search starts from.
    counts: Vec<Slot<f64>>,
    scan: u64,
}

/// Side of the tables that blocks and cells are kept in; a place that is taken is made anew, so any size is right.
const TABLE_SIDE: i32 = 128;
/// Newton steps at most: a bound on the work, a fit that has converged ends before.
const ITERATIONS: u32 = 20;
/// Halvings of a step that does not lower the cost.
const HALVINGS_MAX: u32 = 6;
/// A point so many standard deviations away, squared, has no weight: less than 1e-9.
const FAR: f64 = 41.4;
/// Below this step, metres, the search has converged.
const STEP_MIN: f64 = 1e-4;

#[derive(Clone, Copy, Debug, Default)]
struct Slot<T> {
    scan: u64,
    at: CellIndex,
    value: T,
}

/// Where the robot should be.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// The predicted pose.
    pub pose: Pose,
    /// Where it was before, if it has moved.
    pub from: Option<Point>,
}

impl Expected {
    /// A pose without a past.
    pub fn at(pose: Pose) -> Self {
        Self { pose, from: None }
    }
}

/// The distributions of the four cells that a block is part of.
struct Cells {
    block: CellIndex,
    normals: [Option<Normal>; 4],
}

/// Sides of a block and of a grid cell.
#[derive(Clone, Copy)]
struct Sides {
    /// Cells of the level with 4 × 4 grid cells along a block.
    quarters: i32,
    block_m: f64,
    cell_m: f64,
}

impl Sides {
    fn new(cell_size_m: f64, cell_m: f64) -> Self {
        let quarters = ((0.5 * cell_size_m / (4.0 * cell_m)).round() as i32).max(1);
        Self { quarters, block_m: f64::from(4 * quarters) * cell_m, cell_m }
    }

    fn block_of(self, point: Point) -> CellIndex {
        CellIndex::new(floor(point.x_m / self.block_m), floor(point.y_m / self.block_m))
    }
}

impl Ndt {
    /// The pose (field from points) that makes `points` (metres, frame of the robot) most likely, starting at `start`;
    /// `None` when no point falls into a cell of the map there.
    ///
    /// Minimises `-Σ exp(-qᵀS⁻¹q/2) / 4n` plus half the pulls towards what is `expected`.
    pub fn fit<F: ScoreField>(
        &mut self,
        settings: &NdtSettings,
        field: &F,
        points: &[Point],
        expected: Expected,
        start: Pose,
    ) -> Option<Pose> {
        self.begin();
        let mean_range = points.iter().map(|p| p.norm_m()).sum::<f64>() / points.len().max(1) as f64;
        let scale = Vector3::new(1.0, 1.0, 1.0 / mean_range.max(0.1));
        self.count(Sides::new(settings.cell_size_m, field.reader(Level::Full).cell_size_m()), points, start);
        let mut pose = start;
        let mut terms = self.terms(settings, field, points, expected, pose);
        if terms.hits == 0 {
            return None;
        }
        for _ in 0..ITERATIONS {
            let Some(step) = newton_step(&terms, scale) else { break };
            let Some((next, next_terms)) =
                self.line_search(settings, field, points, expected, (pose, &terms), step)
            else {
                break;
            };
            let length = hypot(pose.distance_m(next), pose.turn_rad(next) * mean_range);
            (pose, terms) = (next, next_terms);
            if length < STEP_MIN {
                break;
            }
        }
        Some(pose)
    }

    /// Drops the distributions of the scan before.
    fn begin(&mut self) {
        let size = (TABLE_SIDE * TABLE_SIDE) as usize;
        self.blocks.resize(size, Slot::default());
        self.cells.resize(size, Slot::default());
        self.counts.resize(size, Slot::default());
        self.scan += 1;
    }

    /// Counts the points in each block.
    fn count(&mut self, sides: Sides, points: &[Point], pose: Pose) {
        for point in points {
            let block = sides.block_of(pose.apply(*point));
            let slot = &mut self.counts[place(block)];
            if slot.scan != self.scan || slot.at != block {
                *slot = Slot { scan: self.scan, at: block, value: 0.0 };
            }
            slot.value += 1.0;
        }
    }

    /// The first of the step, its half, its quarter … that lowers the cost enough (Armijo).
    fn line_search<F: ScoreField>(
        &mut self,
        settings: &NdtSettings,
        field: &F,
        points: &[Point],
        expected: Expected,
        (pose, terms): (Pose, &Terms),
        step: Vector3<f64>,
    ) -> Option<(Pose, Terms)> {
        let slope = terms.gradient.dot(&step);
        let mut share = 1.0;
        for _ in 0..=HALVINGS_MAX {
            let d = step * share;
            let next = Pose::new(pose.x_m + d.x, pose.y_m + d.y, pose.heading_rad + d.z);
            let there = self.terms(settings, field, points, expected, next);
            if there.hits > 0 && there.cost <= terms.cost + 1e-4 * share * slope {
                return Some((next, there));
            }
            share *= 0.5;
        }
        None
    }

    fn terms<F: ScoreField>(
        &mut self,
        settings: &NdtSettings,
        field: &F,
        points: &[Point],
        expected: Expected,
        pose: Pose,
    ) -> Terms {
        let sides = Sides::new(settings.cell_size_m, field.reader(Level::Full).cell_size_m());
        let (sin, cos) = sin_cos(pose.heading_rad);
        let blurs = settings.bearing_sigma_rad > 0.0;
        let (mut cost, mut hits) = (0.0, 0);
        let (mut gradient, mut hessian) = (Vector3::zeros(), Matrix3::zeros());
        // Neighbouring points mostly lie in the same cells.
        let mut cells = Cells { block: CellIndex::new(i32::MIN, i32::MIN), normals: [None; 4] };
        for point in points {
            let turned = Vector2::new(cos * point.x_m - sin * point.y_m, sin * point.x_m + cos * point.y_m);
            let end = turned + Vector2::new(pose.x_m, pose.y_m);
            let blur = Vector2::new(-turned.y, turned.x) * settings.bearing_sigma_rad;
            let block = sides.block_of(Point::new(end.x, end.y));
            if block != cells.block {
                cells = self.cells_at(settings, field, sides, block);
            }
            for normal in cells.normals.iter().flatten() {
                hits += 1;
                let q = end - normal.mean;
                let away = normal.away(q, blur);
                if away.squared > FAR {
                    continue;
                }
                let likelihood = exp(-0.5 * away.squared);
                cost -= likelihood;
                let inverse = if blurs { normal.inverse_with(blur) } else { normal.inverse };
                add_derivatives(&mut gradient, &mut hessian, turned, away.weighted, &inverse, likelihood);
            }
        }
        let share = 1.0 / (4 * points.len().max(1)) as f64;
        let mut terms =
            Terms { cost: cost * share, gradient: gradient * share, hessian: hessian * share, hits };
        terms.pull(expected.pose, pose);
        terms.pull_to_distance(settings.prior_travel, expected, pose);
        terms
    }

    /// The cells that a block is part of.
    fn cells_at<F: ScoreField>(
        &mut self,
        settings: &NdtSettings,
        field: &F,
        sides: Sides,
        block: CellIndex,
    ) -> Cells {
        let normals = [(-1, -1), (0, -1), (-1, 0), (0, 0)].map(|(x, y)| {
            let corner = CellIndex::new(block.x.wrapping_add(x), block.y.wrapping_add(y));
            self.cell(settings, field, sides, corner)
        });
        Cells { block, normals }
    }

    /// The distribution of the 2 × 2 blocks whose lower left one is `corner`.
    fn cell<F: ScoreField>(
        &mut self,
        settings: &NdtSettings,
        field: &F,
        sides: Sides,
        corner: CellIndex,
    ) -> Option<Normal> {
        let place = place(corner);
        let slot = self.cells[place];
        if slot.scan == self.scan && slot.at == corner {
            return slot.value;
        }
        let half = 0.5 * sides.block_m;
        let (mut sums, mut points) = (Moments::default(), 0.0);
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let block = CellIndex::new(corner.x.wrapping_add(x), corner.y.wrapping_add(y));
            let (dx, dy) = (half * f64::from(2 * x - 1), half * f64::from(2 * y - 1));
            sums = sums.plus(self.block(field, sides, block).shifted(dx, dy));
            let counted = self.counts[self::place(block)];
            points += if counted.scan == self.scan && counted.at == block { counted.value } else { 0.0 };
        }
        let center = Point::new(
            (f64::from(corner.x) + 1.0) * sides.block_m,
            (f64::from(corner.y) + 1.0) * sides.block_m,
        );
        let value = sums.normal(center, points, settings, sides.cell_m);
        self.cells[place] = Slot { scan: self.scan, at: corner, value };
        value
    }

    fn block<F: ScoreField>(&mut self, field: &F, sides: Sides, block: CellIndex) -> Moments {
        let place = place(block);
        let slot = self.blocks[place];
        if slot.scan == self.scan && slot.at == block {
            return slot.value;
        }
        let value = gather(field, sides, block);
        self.blocks[place] = Slot { scan: self.scan, at: block, value };
        value
    }
}

/// Sums over the occupied cells of a block.
fn gather<F: ScoreField>(field: &F, sides: Sides, block: CellIndex) -> Moments {
    let (mut coarse, mut fine) = (field.reader(Level::Quarter), field.reader(Level::Full));
    let mut sums = Moments::default();
    let side = sides.quarters;
    let middle = 0.5 * f64::from(4 * side);
    for (i, j) in (0..side).flat_map(|j| (0..side).map(move |i| (i, j))) {
        let (x, y) = (block.x.wrapping_mul(side).wrapping_add(i), block.y.wrapping_mul(side).wrapping_add(j));
        if coarse.cell(CellIndex::new(x, y)) == 0 {
            continue;
        }
        for (k, l) in (0..4).flat_map(|l| (0..4).map(move |k| (k, l))) {
            let cell = CellIndex::new(x.wrapping_mul(4).wrapping_add(k), y.wrapping_mul(4).wrapping_add(l));
            let mass = f64::from(fine.cell(cell)) / f64::from(u16::MAX);
            let from_middle = |n: i32| (f64::from(n) + 0.5 - middle) * sides.cell_m;
            sums.add(mass, from_middle(4 * i + k), from_middle(4 * j + l));
        }
    }
    sums
}

fn place(at: CellIndex) -> usize {
    ((at.y & (TABLE_SIDE - 1)) * TABLE_SIDE + (at.x & (TABLE_SIDE - 1))) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance_consistency::{self, Noise, World};
    use crate::test_room;
    use nalgebra::Matrix2;

    #[test]
    fn finds_the_pose_from_a_prediction_that_is_off() {
        let settings = NdtSettings::default();
        let (mut ndt, mut sum) = (Ndt::default(), 0.0);
        for seed in 0..12 {
            let mut noise = Noise(seed);
            let world = World::new(&mut noise);
            let grid = covariance_consistency::map(&world, &mut noise);
            let truth = covariance_consistency::random_pose(&mut noise);
            let mut off = |reach: f64| noise.between(-reach, reach);
            let start =
                Pose::new(truth.x_m + off(0.08), truth.y_m + off(0.08), truth.heading_rad + off(0.03));
            let points = world.scan(truth, &mut noise);
            let found =
                ndt.fit(&settings, &test_room::field(&grid), &points, Expected::at(start), start).unwrap();
            let again = Ndt::default()
                .fit(&settings, &test_room::field(&grid), &points, Expected::at(start), start)
                .unwrap();
            assert_eq!(found, again);
            assert!(
                found.distance_m(truth) < 0.05 && found.turn_rad(truth) < 0.01,
                "{found:?} for {truth:?}"
            );
            sum += found.distance_m(truth);
        }
        assert!(sum / 12.0 < 0.02, "mean error {}", sum / 12.0);
    }

    #[test]
    fn gradient_and_hessian_are_those_of_the_cost() {
        let grid = test_room::grid(&test_room::ROOM);
        let (field, settings) = (test_room::field(&grid), NdtSettings::default());
        // Few points, none of which crosses into another block within the difference.
        let points = [Point::new(3.93, 0.3), Point::new(-1.9, -0.33), Point::new(0.8, 1.5)];
        let expected = Expected::at(Pose::IDENTITY);
        let mut ndt = Ndt::default();
        ndt.begin();
        let at = Pose::new(0.011, -0.007, 0.005);
        let mut terms = |dx: f64, dy: f64, turn: f64| {
            let pose = Pose::new(at.x_m + dx, at.y_m + dy, at.heading_rad + turn);
            ndt.terms(&settings, &field, &points, expected, pose)
        };
        let here = terms(0.0, 0.0, 0.0);
        assert!(here.hits > 0 && here.cost < 0.0, "the points lie in cells of the map");
        let h = 1e-5;
        for (axis, d) in [(h, 0.0, 0.0), (0.0, h, 0.0), (0.0, 0.0, h)].into_iter().enumerate() {
            let (before, after) = (terms(-d.0, -d.1, -d.2), terms(d.0, d.1, d.2));
            let slope = (after.cost - before.cost) / (2.0 * h);
            assert!((slope - here.gradient[axis]).abs() < 1e-5, "{slope} for {}", here.gradient[axis]);
            let change = (after.gradient - before.gradient) / (2.0 * h);
            assert!((change - here.hessian.column(axis)).amax() < 1e-3 * here.hessian.amax());
        }
    }

    #[test]
    fn a_blurred_point_is_as_far_off_as_both_covariances_say() {
        let normal = Normal { mean: Vector2::zeros(), inverse: Matrix2::new(9.0, 1.0, 1.0, 4.0) };
        let blur = Vector2::new(0.3, -0.8);
        let sum = normal.inverse.try_inverse().unwrap() + blur * blur.transpose();
        assert!((normal.inverse_with(blur) * sum - Matrix2::identity()).amax() < 1e-12);
    }

    #[test]
    fn odometry_constrains_the_distance_and_not_the_direction() {
        let expected = Expected { pose: Pose::new(3.0, 0.0, 0.0), from: Some(Point::new(1.0, 0.0)) };
        let cost = |pose: Pose| {
            let (gradient, hessian) = (Vector3::zeros(), Matrix3::zeros());
            let mut terms = Terms { cost: 0.0, gradient, hessian, hits: 0 };
            terms.pull_to_distance(2.0, expected, pose);
            terms.cost
        };
        assert!(cost(Pose::new(1.0, 2.0, 0.0)) < 1e-12, "as far, elsewhere");
        assert!((cost(Pose::new(1.0, 2.5, 0.0)) - 0.25).abs() < 1e-12, "half a metre too far");
    }

    #[test]
    fn no_cell_hit_is_no_match() {
        let grid = test_room::grid(&test_room::ROOM);
        let far = [Point::new(500.0, 0.0)];
        let found = Ndt::default().fit(
            &NdtSettings::default(),
            &test_room::field(&grid),
            &far,
            Expected::at(Pose::IDENTITY),
            Pose::IDENTITY,
        );
        assert_eq!(found, None);
    }
}
