//! The matchers of vinySLAM: random search and hill climbing on the score of single cells.

use flockslam_evidence::Level;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_random::Random;
use flockslam_registration::{ScoreField, ScoreRead, nearest};

/// Standard deviations of the random search's first samples, as vinySLAM has them: metres and radians.
const SAMPLE_SIGMA: (f64, f64) = (0.2, 0.1);
/// Failures since the last shrink after which the random search stops, as in vinySLAM.
const SAMPLE_FAILURES_MAX: u32 = 20;
/// Poses that the random search tries at most, as in vinySLAM.
const SAMPLE_POSES_MAX: u32 = 100;
/// First steps of hill climbing, as in vinySLAM: metres and radians.
const CLIMB_STEP: (f64, f64) = (0.1, 0.1);
/// Rounds without success after which hill climbing stops, as in vinySLAM: its steps are a sixty-fourth by then.
const CLIMB_FAILED_ROUNDS_MAX: u32 = 6;
/// Rounds of hill climbing at most, whatever the field looks like.
const ROUNDS_MAX: u32 = 1000;

/// vinySLAM's weight of a beam: `sqrt(range) · (3 if |cos a| > .9; 2 if > .8; else |sin a| + |cos a|)` with `a` the
/// direction of the point from the robot.
pub fn beam_weight(point: Point) -> f64 {
    let range = point.norm_m();
    if range == 0.0 {
        return 0.0;
    }
    let (cos, sin) = ((point.x_m / range).abs(), (point.y_m / range).abs());
    let direction = if cos > 0.9 {
        3.0
    } else if cos > 0.8 {
        2.0
    } else {
        sin + cos
    };
    range.sqrt() * direction
}

/// Mean score of the cells that the points fall into, weighted.
fn weighted_score<F: ScoreField>(field: &F, points: &[Point], weights: &[f64], pose: Pose) -> f64 {
    let mut read = field.reader(Level::Full);
    let per_metre = 1.0 / read.cell_size_m();
    let (sin, cos) = sin_cos(pose.heading_rad);
    let (mut sum, mut total) = (0.0, 0.0);
    for (point, weight) in points.iter().zip(weights) {
        let x = cos * point.x_m - sin * point.y_m + pose.x_m;
        let y = sin * point.x_m + cos * point.y_m + pose.y_m;
        sum += weight * nearest(&mut read, per_metre, x, y);
        total += weight;
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

/// The random search [Filatov, "Monte Carlo method in scan matching"] around `start`; `seed` fixes the samples. Gives the best pose and
/// its score.
pub fn monte_carlo<F: ScoreField>(
    field: &F,
    points: &[Point],
    weights: &[f64],
    start: Pose,
    seed: u64,
) -> (Pose, f64) {
    let mut random = Random::seeded(seed);
    let (mut best, mut best_score) = (start, weighted_score(field, points, weights, start));
    let (mut sigma_xy, mut sigma_heading) = SAMPLE_SIGMA;
    let mut failures = 0;
    for _ in 0..SAMPLE_POSES_MAX {
        let (dx, dy) = random.normal_pair();
        let (turn, _) = random.normal_pair();
        let pose = Pose::new(
            best.x_m + sigma_xy * dx,
            best.y_m + sigma_xy * dy,
            best.heading_rad + sigma_heading * turn,
        );
        let score = weighted_score(field, points, weights, pose);
        if score > best_score {
            (best, best_score) = (pose, score);
            if failures > SAMPLE_FAILURES_MAX / 3 {
                (sigma_xy, sigma_heading, failures) = (0.5 * sigma_xy, 0.5 * sigma_heading, 0);
            }
        } else {
            failures += 1;
            if failures >= SAMPLE_FAILURES_MAX {
                break;
            }
        }
    }
    (best, best_score)
}

/// The deterministic search by steps along each axis, halved after a round without success. Climbs from `start`; gives the best pose and
/// its score.
pub fn hill_climbing<F: ScoreField>(
    field: &F,
    points: &[Point],
    weights: &[f64],
    start: Pose,
) -> (Pose, f64) {
    let (mut best, mut best_score) = (start, weighted_score(field, points, weights, start));
    let ((mut step, mut turn), mut failed) = (CLIMB_STEP, 0);
    for _ in 0..ROUNDS_MAX {
        if failed >= CLIMB_FAILED_ROUNDS_MAX {
            break;
        }
        let before = best_score;
        for (dx, dy, dt) in [
            (step, 0.0, 0.0),
            (-step, 0.0, 0.0),
            (0.0, step, 0.0),
            (0.0, -step, 0.0),
            (0.0, 0.0, turn),
            (0.0, 0.0, -turn),
        ] {
            let pose = Pose::new(best.x_m + dx, best.y_m + dy, best.heading_rad + dt);
            let score = weighted_score(field, points, weights, pose);
            if score > best_score {
                (best, best_score) = (pose, score);
            }
        }
        if best_score <= before {
            (step, turn, failed) = (0.5 * step, 0.5 * turn, failed + 1);
        }
    }
    (best, best_score)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::CellIndex;

    /// A room of 6 × 4 m: the score of a cell falls off with the distance to the nearest wall. (Walls on the edge between two
    /// cells would have no slope.)
    #[derive(Clone, Copy)]
    struct Walls;

    /// Distances of the walls from the middle, metres.
    const HALF_M: (f64, f64) = (2.98, 2.02);

    const CELL_M: f64 = 0.05;

    impl ScoreField for Walls {
        type Reader<'a> = Self;

        fn reader(&self, _: Level) -> Self {
            *self
        }

        fn covers(&self, _: Point) -> bool {
            true
        }
    }

    impl ScoreRead for Walls {
        fn cell_size_m(&self) -> f64 {
            CELL_M
        }

        fn cell(&mut self, cell: CellIndex) -> u16 {
            let center = |index: i32| (f64::from(index) + 0.5) * CELL_M;
            let to_wall = |x_m: f64, half_m: f64| (x_m.abs() - half_m).abs();
            let wall_m = to_wall(center(cell.x), HALF_M.0).min(to_wall(center(cell.y), HALF_M.1));
            (65_535.0 * (-0.5 * (wall_m / 0.06).powi(2)).exp()) as u16
        }

        fn block(&mut self, cell: CellIndex) -> [u16; 4] {
            [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| self.cell(CellIndex::new(cell.x + x, cell.y + y)))
        }

        fn row(&mut self, first: CellIndex, scores: &mut [u16]) {
            for (x, score) in (first.x..).zip(scores) {
                *score = self.cell(CellIndex::new(x, first.y));
            }
        }
    }

    /// What a lidar at `pose` sees of the walls: points in its own frame.
    fn scan(pose: Pose) -> Vec<Point> {
        let along = |length_m: f64| (0..40).map(move |i| (f64::from(i) / 39.0 - 0.5) * length_m);
        let east_west = along(4.0).flat_map(|y| [Point::new(HALF_M.0, y), Point::new(-HALF_M.0, y)]);
        let north_south = along(6.0).flat_map(|x| [Point::new(x, HALF_M.1), Point::new(x, -HALF_M.1)]);
        east_west.chain(north_south).map(|point| pose.inverse().apply(point)).collect()
    }

    #[test]
    fn climbing_improves_the_guess_sampling_mostly_does_and_both_repeat_themselves() {
        let truth = Pose::new(0.4, -0.3, 0.7);
        let points = scan(truth);
        let weights: Vec<f64> = points.iter().map(|point| beam_weight(*point)).collect();
        let start = Pose::new(0.5, -0.35, 0.75);
        let before = weighted_score(&Walls, &points, &weights, start);
        let climb = || hill_climbing(&Walls, &points, &weights, start);
        let sample = |seed| monte_carlo(&Walls, &points, &weights, start, seed);
        assert!(climb().1 > 2.0 * before && climb().0.distance_m(truth) < 0.05);
        let mut improved = 0;
        for seed in 0..16 {
            let found = sample(seed);
            assert_eq!(found, sample(seed), "seed {seed}");
            assert!(found.1 >= before, "seed {seed}: {found:?}");
            improved += u32::from(found.1 > before);
        }
        assert!(improved >= 8, "{improved} of 16 seeds");
        assert_eq!(climb(), climb());
        assert_ne!(sample(7), sample(8));
    }

    #[test]
    fn beams_ahead_and_behind_weigh_most() {
        assert_eq!(beam_weight(Point::new(4.0, 0.0)), 6.0);
        assert_eq!(beam_weight(Point::new(-3.4, 2.1)), 2.0 * 3.4f64.hypot(2.1).sqrt());
        assert_eq!((beam_weight(Point::new(0.0, 9.0)), beam_weight(Point::new(0.0, 0.0))), (3.0, 0.0));
    }
}
