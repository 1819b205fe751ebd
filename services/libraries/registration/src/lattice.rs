//! Correlative matching on a lattice around the prediction (Olson 2009; Hess et al. 2016), refined below a cell: a matching
//! strategy of its own, and the start of a fit without odometry.

use crate::Window;
use crate::bounds::NodeBounds;
use crate::correlative::{REACH_MAX, end_cells, farthest_m, mean_score, node_bound, sample};
use crate::field::{ScoreField, ScoreRead};
use crate::gauss_newton::{Fit, GaussNewton};
use flockslam_evidence::{CellIndex, Level, floor};
use flockslam_geometry::{Point, Pose};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Headings tried at most on either side.
const HEADINGS_MAX: i32 = 128;
/// Nodes opened at most: a search that has not ended by then gives the best lattice pose known so far.
const NODES_MAX: usize = 50_000;
/// Points used at most in the search, whose cost grows with them; the refinement uses all.
const POINTS_MAX: usize = 100;
/// Score that a pose loses per m² between it and the window's centre: of poses that fit about as well the nearest is taken.
const PRIOR_XY: f64 = 5.0;
/// Score that it loses per rad², for the same reason.
const PRIOR_HEADING: f64 = 1.0;
/// What a pose loses of its score, 0 … 1, as the nearest pose of the lattice: a better one than a pose off the lattice may look worse by this.
const OFF_LATTICE: f64 = 0.1;
/// Gauss–Newton steps on the finest level behind the search: they begin within half a cell.
const REFINEMENTS: u32 = 8;

/// Correlative matching in several resolutions (Olson 2009) by branch and bound over the max-pooled pyramid (Hess et al.
/// 2016, section V): exact on a lattice of the grid's own cells.
///
/// A node is a heading and 4 × 4, 2 × 2 or one translation of the lattice; its bound is the greatest mean score that the
/// points can reach in the level whose cells are as wide, less the least pull of the prediction. Nodes are opened in the
/// order of their bounds, so the first single pose that comes up is the best of the window.
#[derive(Clone, Debug, Default)]
pub struct Correlative {
    sample: Vec<Point>,
    /// Cells that the sample ends in at the window's centre, heading by heading.
    ends: Vec<CellIndex>,
    /// Those of the pose at hand.
    known: Vec<CellIndex>,
    bounds: NodeBounds,
    open: BinaryHeap<Node>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bound: f64,
    level: Level,
    heading: i32,
    x: i32,
    y: i32,
}

impl Node {
    /// Equal bounds are ordered by place: the result must not depend on the order of insertion.
    fn rank(&self) -> (std::cmp::Reverse<Level>, i32, i32, i32) {
        (std::cmp::Reverse(self.level), self.heading, self.x, self.y)
    }
}

impl Ord for Node {
    fn cmp(&self, other: &Self) -> Ordering {
        self.bound.total_cmp(&other.bound).then_with(|| self.rank().cmp(&other.rank()))
    }
}

impl PartialOrd for Node {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Node {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Node {}

/// The lattice of one search.
struct Lattice {
    window: Window,
    step_m: f64,
    step_rad: f64,
    /// Headings on either side of the middle.
    headings: i32,
}

impl Lattice {
    fn pose(&self, heading: i32, x: i32, y: i32) -> Pose {
        let center = self.window.center;
        Pose::new(
            center.x_m + self.step_m * f64::from(x),
            center.y_m + self.step_m * f64::from(y),
            center.heading_rad + self.step_rad * f64::from(heading),
        )
    }

    /// The least pull of the prediction on the poses of a node `side` steps wide.
    fn pull(&self, heading: i32, x: i32, y: i32, side: i32) -> f64 {
        let near = |from: i32| f64::from(0.clamp(from, from + side - 1)) * self.step_m;
        let turn = f64::from(heading) * self.step_rad;
        PRIOR_XY * (near(x).powi(2) + near(y).powi(2)) + PRIOR_HEADING * turn * turn
    }
}

fn side(level: Level) -> i32 {
    1 << level as u32
}

impl Correlative {
    /// Fits `points` (metres, frame of the robot) to a field inside a window around the prediction, and refines the best
    /// lattice pose by Gauss–Newton on the finest level. Needs at least one point.
    pub fn fit<F: ScoreField>(&mut self, field: &F, points: &[Point], window: Window) -> Fit {
        let prediction = window.center;
        let start = self.search(field, points, window, prediction).map_or(prediction, |(_, pose)| pose);
        let solver = GaussNewton { iterations: [0, 0, REFINEMENTS] };
        solver.fit(field, points, prediction, start)
    }

    /// The best pose of the lattice and its mean score less the prediction's pull; `None` when no pose of the window
    /// scores better than its centre, the prediction, or about as well as `known`, a pose at hand: the better that one, the less is
    /// looked at.
    pub fn search<F: ScoreField>(
        &mut self,
        field: &F,
        points: &[Point],
        window: Window,
        known: Pose,
    ) -> Option<(f64, Pose)> {
        let step_m = field.reader(Level::Full).cell_size_m();
        sample(points, POINTS_MAX, f64::from(side(Level::Quarter)) * step_m, &mut self.sample);
        self.open.clear();
        if self.sample.is_empty() {
            return None;
        }
        let step_rad = self.heading_step(step_m);
        let lattice = Lattice {
            window,
            step_m,
            step_rad,
            headings: ((window.reach_rad / step_rad).ceil() as i32).clamp(0, HEADINGS_MAX),
        };
        self.ends.clear();
        for heading in -lattice.headings..=lattice.headings {
            self.ends.extend(end_cells(&self.sample, lattice.pose(heading, 0, 0), step_m));
        }
        let at_center = self.bound(field, &lattice, Level::Full, (0, 0, 0), -1.0)?;
        let floor_score = at_center.max(self.score_at(field, &lattice, known) - OFF_LATTICE);
        self.open_window(field, &lattice, floor_score);
        for _ in 0..NODES_MAX {
            let node = self.open.pop()?;
            let Some(finer) = finer(node.level) else {
                return Some((node.bound, lattice.pose(node.heading, node.x, node.y)));
            };
            let half = side(finer);
            for (x, y) in [(0, 0), (half, 0), (0, half), (half, half)] {
                self.push(field, &lattice, finer, (node.heading, node.x + x, node.y + y), floor_score);
            }
        }
        None
    }

    /// Score of a pose off the lattice, less its pull.
    fn score_at<F: ScoreField>(&mut self, field: &F, lattice: &Lattice, pose: Pose) -> f64 {
        let window = lattice.window;
        self.known.clear();
        self.known.extend(end_cells(&self.sample, pose, lattice.step_m));
        let (away_m, turn_rad) = (pose.distance_m(window.center), pose.turn_rad(window.center));
        let pull = PRIOR_XY * away_m * away_m + PRIOR_HEADING * turn_rad * turn_rad;
        mean_score(&mut field.reader(Level::Full), &self.known, (0, 0)) - pull
    }

    /// The turn that moves a typical point by one step.
    fn heading_step(&self, step_m: f64) -> f64 {
        let mean_range = self.sample.iter().map(|p| p.norm_m()).sum::<f64>() / self.sample.len() as f64;
        (step_m / mean_range.max(step_m)).clamp(0.005, 0.06)
    }

    fn open_window<F: ScoreField>(&mut self, field: &F, lattice: &Lattice, floor_score: f64) {
        let (center, wide) = (lattice.window.center, side(Level::Quarter));
        let wide_m = f64::from(wide) * lattice.step_m;
        let reach = ((lattice.window.reach_m / wide_m).ceil() as i32).clamp(1, REACH_MAX);
        let radius = (farthest_m(&self.sample) / wide_m).ceil() as i32 + 1;
        let middle = CellIndex::new(floor(center.x_m / wide_m), floor(center.y_m / wide_m));
        self.bounds.lay_out(&mut field.reader(Level::Quarter), middle, radius, reach);
        for (heading, ends) in (-lattice.headings..).zip(self.ends.chunks_exact(self.sample.len())) {
            self.bounds.sum(ends, Level::Quarter as u32);
            let (level, step) = (Level::Quarter, |place: i32| wide * place);
            self.open.extend(self.bounds.above(floor_score).filter_map(|(bound, x, y)| {
                let (x, y) = (step(x), step(y));
                let bound = bound - lattice.pull(heading, x, y, wide);
                (bound > floor_score).then_some(Node { bound, level, heading, x, y })
            }));
        }
    }

    fn push<F: ScoreField>(
        &mut self,
        field: &F,
        lattice: &Lattice,
        level: Level,
        place: (i32, i32, i32),
        floor_score: f64,
    ) {
        if let Some(bound) = self.bound(field, lattice, level, place, floor_score) {
            let (heading, x, y) = place;
            self.open.push(Node { bound, level, heading, x, y });
        }
    }

    /// The most that a pose of the node can reach; `None` when that is not above `floor_score`.
    fn bound<F: ScoreField>(
        &self,
        field: &F,
        lattice: &Lattice,
        level: Level,
        (heading, x, y): (i32, i32, i32),
        floor_score: f64,
    ) -> Option<f64> {
        let pull = lattice.pull(heading, x, y, side(level));
        let first = (heading + lattice.headings) as usize * self.sample.len();
        let ends = &self.ends[first..first + self.sample.len()];
        let mut read = field.reader(level);
        if level > Level::Full {
            return node_bound(&mut read, ends, (x, y), level as u32, floor_score + pull)
                .map(|score| score - pull);
        }
        let bound = mean_score(&mut read, ends, (x, y)) - pull;
        (bound > floor_score).then_some(bound)
    }
}

fn finer(level: Level) -> Option<Level> {
    match level {
        Level::Quarter => Some(Level::Half),
        Level::Half => Some(Level::Full),
        Level::Full => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{nearest, test_room};

    fn window(center: Pose) -> Window {
        Window { center, reach_m: 0.25, reach_rad: 0.2 }
    }

    fn score_at(points: &[Point], field: &impl ScoreField, pose: Pose) -> f64 {
        let mut read = field.reader(Level::Full);
        let per_metre = 1.0 / read.cell_size_m();
        let at = |p: &Point| {
            let end = pose.apply(*p);
            nearest(&mut read, per_metre, end.x_m, end.y_m)
        };
        points.iter().map(at).sum::<f64>() / points.len() as f64
    }

    #[test]
    fn no_pose_of_the_lattice_is_better_than_the_one_found() {
        let grid = test_room::grid(&test_room::ROOM);
        let field = test_room::field(&grid);
        for (truth, off) in [
            (Pose::new(0.4, -0.3, 0.7), Pose::new(0.2, 0.13, 0.11)),
            (Pose::new(1.0, 0.2, -2.0), Pose::new(-0.18, 0.1, -0.15)),
        ] {
            let points: Vec<Point> = test_room::scan(truth).into_iter().step_by(2).collect();
            let center =
                Pose::new(truth.x_m + off.x_m, truth.y_m + off.y_m, truth.heading_rad + off.heading_rad);
            let mut matcher = Correlative::default();
            let (score, pose) = matcher.search(&field, &points, window(center), center).unwrap();
            let step_rad = matcher.heading_step(0.05);
            let mut best = f64::NEG_INFINITY;
            let headings = (window(center).reach_rad / step_rad).ceil() as i32;
            for heading in -headings..=headings {
                for (x, y) in (-8..8).flat_map(|x| (-8..8).map(move |y| (x, y))) {
                    let (dx, dy) = (0.05 * f64::from(x), 0.05 * f64::from(y));
                    let turn = step_rad * f64::from(heading);
                    let at = Pose::new(center.x_m + dx, center.y_m + dy, center.heading_rad + turn);
                    let pull = PRIOR_XY * (dx * dx + dy * dy) + PRIOR_HEADING * turn * turn;
                    best = best.max(score_at(&points, &field, at) - pull);
                }
            }
            assert!((score - best).abs() < 1e-9, "{score} for {best}");
            assert!(pose.distance_m(truth) < 0.08 && pose.turn_rad(truth) < 0.03);
            let again = matcher.search(&field, &points, window(center), truth);
            assert_eq!(again, Some((score, pose)));
            let fit = matcher.fit(&field, &points, window(center));
            assert!(fit.pose.distance_m(truth) < 0.01 && fit.pose.turn_rad(truth) < 0.005, "{:?}", fit.pose);
        }
    }

    #[test]
    fn where_nothing_is_better_the_prediction_stays() {
        let grid = test_room::grid(&[]);
        let start = Pose::new(0.3, 0.2, 0.1);
        let points = test_room::scan(start);
        let mut matcher = Correlative::default();
        assert!(matcher.search(&test_room::field(&grid), &points, window(start), start).is_none());
        assert!(matcher.search(&test_room::field(&grid), &[], window(start), start).is_none());
        let fit = matcher.fit(&test_room::field(&grid), &points, window(start));
        assert_eq!(fit.pose, start);
    }
}
