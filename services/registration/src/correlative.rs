use crate::field::{ScoreField, ScoreRead, nearest};
use flockslam_evidence::{CellIndex, Level, floor};
use flockslam_geometry::{Point, Pose};

/// Points used at most; more do not find other poses.
const POINTS_MAX: usize = 100;
/// Headings tried at most on either side.
const HEADINGS_MAX: i32 = 64;

/// Exhaustive search for a pose around a guess by branch and bound (Olson 2009; Hess et al. 2016, section V).
///
/// Poses lie on a lattice of twice the grid's cells; a node holds 2 × 2 translations of it, and its bound is the
/// greatest score that its points can reach in the field pooled once more. The search is exact on that lattice.
#[derive(Clone, Debug, Default)]
pub struct CorrelativeSearch {
    sample: Vec<Point>,
    turned: Vec<Point>,
    nodes: Vec<Node>,
    found: Vec<(f64, Pose)>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bound: f64,
    heading: i32,
    x: i32,
    y: i32,
}

/// Where to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Middle of the window.
    pub center: Pose,
    /// Half its width and height, metres.
    pub reach_m: f64,
    /// Half its range of headings, radians.
    pub reach_rad: f64,
}

impl CorrelativeSearch {
    /// The best `wanted` poses in the window with their scores on the pooled field, best first. Only poses are found
    /// whose score there is better than that of `rival` by more than `gain`.
    pub fn search<F: ScoreField>(
        &mut self,
        field: &F,
        points: &[Point],
        window: Window,
        (rival, gain): (Pose, f64),
        wanted: usize,
    ) -> &[(f64, Pose)] {
        self.found.clear();
        self.nodes.clear();
        self.take_sample(points);
        if self.sample.is_empty() || wanted == 0 {
            return &self.found;
        }
        let step_m = field.reader(Level::Half).cell_size_m();
        let step_rad = self.heading_step(step_m);
        let floor_score = self.pooled_score(field, rival) + gain;
        self.bound_nodes(field, window, step_m, step_rad, floor_score);
        // Equal bounds are told apart by place: the result must not depend on the sort.
        self.nodes.sort_unstable_by(|a, b| {
            b.bound.total_cmp(&a.bound).then((a.heading, a.x, a.y).cmp(&(b.heading, b.x, b.y)))
        });
        let mut nodes = std::mem::take(&mut self.nodes);
        for node in &nodes {
            let least = if self.found.len() < wanted { floor_score } else { self.found[wanted - 1].0 };
            if node.bound <= least {
                break;
            }
            self.score_children(field, window.center, *node, step_m, step_rad, wanted);
        }
        nodes.clear();
        self.nodes = nodes;
        &self.found
    }

    fn take_sample(&mut self, points: &[Point]) {
        let stride = points.len().div_ceil(POINTS_MAX).max(1);
        self.sample.clear();
        self.sample.extend(points.iter().step_by(stride));
    }

    fn pooled_score<F: ScoreField>(&mut self, field: &F, pose: Pose) -> f64 {
        self.turn(pose.heading_rad);
        let mut read = field.reader(Level::Half);
        let per_metre = 1.0 / read.cell_size_m();
        let score = |p: &Point| nearest(&mut read, per_metre, p.x_m + pose.x_m, p.y_m + pose.y_m);
        self.turned.iter().map(score).sum::<f64>() / self.turned.len() as f64
    }

    /// The turn that moves a typical point by one step.
    fn heading_step(&self, step_m: f64) -> f64 {
        let mean_range = self.sample.iter().map(|p| p.norm_m()).sum::<f64>() / self.sample.len() as f64;
        (step_m / mean_range.max(step_m)).clamp(0.01, 0.06)
    }

    fn turn(&mut self, heading_rad: f64) {
        let turn = Pose::new(0.0, 0.0, heading_rad);
        self.turned.clear();
        self.turned.extend(self.sample.iter().map(|point| turn.apply(*point)));
    }

    fn bound_nodes<F: ScoreField>(
        &mut self,
        field: &F,
        window: Window,
        step_m: f64,
        step_rad: f64,
        floor_score: f64,
    ) {
        let mut read = field.reader(Level::Quarter);
        let per_metre = 1.0 / read.cell_size_m();
        let headings = ((window.reach_rad / step_rad).ceil() as i32).clamp(0, HEADINGS_MAX);
        let reach = ((window.reach_m / (2.0 * step_m)).ceil() as i32).max(0);
        for heading in -headings..=headings {
            self.turn(window.center.heading_rad + f64::from(heading) * step_rad);
            for (y, x) in (-reach..reach).flat_map(|y| (-reach..reach).map(move |x| (y, x))) {
                let dx = window.center.x_m + 2.0 * step_m * f64::from(x);
                let dy = window.center.y_m + 2.0 * step_m * f64::from(y);
                if let Some(bound) = upper_bound(&mut read, per_metre, &self.turned, (dx, dy), floor_score) {
                    self.nodes.push(Node { bound, heading, x, y });
                }
            }
        }
    }

    fn score_children<F: ScoreField>(
        &mut self,
        field: &F,
        center: Pose,
        node: Node,
        step_m: f64,
        step_rad: f64,
        wanted: usize,
    ) {
        let heading_rad = center.heading_rad + f64::from(node.heading) * step_rad;
        self.turn(heading_rad);
        let mut read = field.reader(Level::Half);
        let per_metre = 1.0 / read.cell_size_m();
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let dx = center.x_m + step_m * f64::from(2 * node.x + x);
            let dy = center.y_m + step_m * f64::from(2 * node.y + y);
            let sum: f64 =
                self.turned.iter().map(|p| nearest(&mut read, per_metre, p.x_m + dx, p.y_m + dy)).sum();
            self.keep(sum / self.turned.len() as f64, Pose::new(dx, dy, heading_rad), wanted);
        }
    }

    fn keep(&mut self, score: f64, pose: Pose, wanted: usize) {
        let place = self.found.partition_point(|(better, _)| *better >= score);
        if place < wanted {
            self.found.truncate(wanted - 1);
            self.found.insert(place, (score, pose));
        }
    }
}

/// Points after which a bound that cannot reach the floor any more is given up.
const BOUND_CHUNK: usize = 10;

/// Greatest mean score of the points when they move by (dx, dy) plus 0 or half a cell of the level along each axis;
/// `None` when that is not above `floor_score`.
pub(crate) fn upper_bound(
    read: &mut impl ScoreRead,
    per_metre: f64,
    points: &[Point],
    (dx, dy): (f64, f64),
    floor_score: f64,
) -> Option<f64> {
    let full = f64::from(u16::MAX);
    // What may still be lost before the mean falls to the floor.
    let mut spare = (1.0 - floor_score) * points.len() as f64 * full;
    for chunk in points.chunks(BOUND_CHUNK) {
        for point in chunk {
            let cell =
                CellIndex::new(floor((point.x_m + dx) * per_metre), floor((point.y_m + dy) * per_metre));
            let block = read.block(cell);
            spare -= full - f64::from(block[0].max(block[1]).max(block[2]).max(block[3]));
        }
        if spare <= 0.0 {
            return None;
        }
    }
    Some(floor_score + spare / (points.len() as f64 * full))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{field::ScoreField, room};

    /// Every pose of the lattice, one by one.
    fn best_by_brute_force(
        grid: &flockslam_evidence::TileGrid<Box<flockslam_evidence::Tile>>,
        points: &[Point],
        window: Window,
    ) -> f64 {
        let mut search = CorrelativeSearch::default();
        search.take_sample(points);
        let step_rad = search.heading_step(0.1);
        let field = room::field(grid);
        let mut read = field.reader(Level::Half);
        let (headings, reach) =
            ((window.reach_rad / step_rad).ceil() as i32, (window.reach_m / 0.2).ceil() as i32);
        let mut best = 0.0f64;
        for heading in -headings..=headings {
            search.turn(window.center.heading_rad + f64::from(heading) * step_rad);
            for (x, y) in (-2 * reach..2 * reach).flat_map(|x| (-2 * reach..2 * reach).map(move |y| (x, y))) {
                let (dx, dy) =
                    (window.center.x_m + 0.1 * f64::from(x), window.center.y_m + 0.1 * f64::from(y));
                let sum: f64 =
                    search.turned.iter().map(|p| nearest(&mut read, 10.0, p.x_m + dx, p.y_m + dy)).sum();
                best = best.max(sum / search.turned.len() as f64);
            }
        }
        best
    }

    #[test]
    fn finds_the_best_pose_of_the_window_and_no_worse_than_trying_all() {
        let grid = room::grid(&room::ROOM);
        for (truth, off) in [
            (Pose::new(0.4, -0.3, 0.7), Pose::new(0.4, 0.3, 0.3)),
            (Pose::new(1.0, 0.2, -2.0), Pose::new(-0.5, 0.1, -0.2)),
        ] {
            let points = room::scan(truth);
            let center =
                Pose::new(truth.x_m + off.x_m, truth.y_m + off.y_m, truth.heading_rad + off.heading_rad);
            let window = Window { center, reach_m: 0.6, reach_rad: 0.35 };
            let mut search = CorrelativeSearch::default();
            let found = search.search(&room::field(&grid), &points, window, (center, 0.0), 3).to_vec();
            assert!(found.len() == 3 && found[0].0 >= found[1].0 && found[1].0 >= found[2].0);
            assert!((found[0].0 - best_by_brute_force(&grid, &points, window)).abs() < 1e-12);
            assert!(
                found[0].1.distance_m(truth) < 0.12 && found[0].1.turn_rad(truth) < 0.06,
                "{:?}",
                found[0]
            );
        }
    }

    #[test]
    fn a_rival_that_cannot_be_beaten_ends_the_search() {
        let grid = room::grid(&room::ROOM);
        let truth = Pose::new(0.4, -0.3, 0.7);
        let window = Window { center: truth, reach_m: 0.6, reach_rad: 0.35 };
        let mut search = CorrelativeSearch::default();
        assert!(search.search(&room::field(&grid), &room::scan(truth), window, (truth, 0.2), 3).is_empty());
        assert!(search.search(&room::field(&grid), &[], window, (truth, 0.0), 3).is_empty());
    }
}
