//! The wide search after a bad fit: branch and bound over a window (Olson 2009; Hess et al. 2016). Takes points, a field
//! and a window, gives the best poses with their scores.

use crate::bounds::NodeBounds;
use crate::field::{ScoreField, ScoreRead};
use flockslam_evidence::{CellIndex, Level, floor};
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};

/// Points used at most; more do not find other poses.
const POINTS_MAX: usize = 100;
/// Headings tried at most on either side.
const HEADINGS_MAX: i32 = 64;
/// Nodes tried at most to either side.
pub(crate) const REACH_MAX: i32 = 128;
/// Points further away than this many cells of the widest level are left out of a search.
const RADIUS_MAX: f64 = 512.0;

/// Exhaustive search for a pose around a guess by branch and bound (Olson 2009; Hess et al. 2016, section V).
///
/// Poses lie on a lattice of twice the grid's cells; a node holds 2 × 2 translations of it, and its bound is the
/// greatest score that its points can reach in the field pooled once more. The search is exact on that lattice.
#[derive(Clone, Debug, Default)]
pub struct CorrelativeSearch {
    sample: Vec<Point>,
    /// Where the sample ends at the heading that is looked at and the window's centre, in cells of the middle level.
    ends: Vec<CellIndex>,
    bounds: NodeBounds,
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

/// The search window.
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
    /// whose score there is better than that of `alternative` by more than `gain`.
    pub fn search<F: ScoreField>(
        &mut self,
        field: &F,
        points: &[Point],
        window: Window,
        (alternative, gain): (Pose, f64),
        wanted: usize,
    ) -> &[(f64, Pose)] {
        self.found.clear();
        self.nodes.clear();
        let step_m = field.reader(Level::Half).cell_size_m();
        self.take_sample(points, step_m);
        if self.sample.is_empty() || wanted == 0 {
            return &self.found;
        }
        let step_rad = self.heading_step(step_m);
        self.turn(alternative, step_m);
        let floor_score = mean_score(&mut field.reader(Level::Half), &self.ends, (0, 0)) + gain;
        self.bound_nodes(field, window, step_m, step_rad, floor_score);
        // Equal bounds are ordered by place: the result must not depend on the sort.
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

    fn take_sample(&mut self, points: &[Point], step_m: f64) {
        sample(points, POINTS_MAX, 2.0 * step_m, &mut self.sample);
    }

    /// The turn that moves a typical point by one step.
    fn heading_step(&self, step_m: f64) -> f64 {
        let mean_range = self.sample.iter().map(|p| p.norm_m()).sum::<f64>() / self.sample.len() as f64;
        (step_m / mean_range.max(step_m)).clamp(0.01, 0.06)
    }

    fn turn(&mut self, pose: Pose, step_m: f64) {
        self.ends.clear();
        self.ends.extend(end_cells(&self.sample, pose, step_m));
    }

    fn bound_nodes<F: ScoreField>(
        &mut self,
        field: &F,
        window: Window,
        step_m: f64,
        step_rad: f64,
        floor_score: f64,
    ) {
        let headings = ((window.reach_rad / step_rad).ceil() as i32).clamp(0, HEADINGS_MAX);
        let wide_m = 2.0 * step_m;
        let reach = ((window.reach_m / wide_m).ceil() as i32).clamp(1, REACH_MAX);
        let radius = (farthest_m(&self.sample) / wide_m).ceil() as i32 + 1;
        let middle = CellIndex::new(floor(window.center.x_m / wide_m), floor(window.center.y_m / wide_m));
        self.bounds.lay_out(&mut field.reader(Level::Quarter), middle, radius, reach);
        for heading in -headings..=headings {
            self.turn(turned(window.center, heading, step_rad), step_m);
            self.bounds.sum(&self.ends, 1);
            let nodes = self.bounds.above(floor_score);
            self.nodes.extend(nodes.map(|(bound, x, y)| Node { bound, heading, x, y }));
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
        let center = turned(center, node.heading, step_rad);
        self.turn(center, step_m);
        let mut read = field.reader(Level::Half);
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (x, y) = (2 * node.x + x, 2 * node.y + y);
            let pose = Pose {
                x_m: center.x_m + step_m * f64::from(x),
                y_m: center.y_m + step_m * f64::from(y),
                ..center
            };
            self.keep(mean_score(&mut read, &self.ends, (x, y)), pose, wanted);
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

/// At most `count` of the points, evenly taken, that are not further away than a search can look (in cells of a side).
pub(crate) fn sample(points: &[Point], count: usize, side_m: f64, sample: &mut Vec<Point>) {
    let stride = points.len().div_ceil(count.max(1)).max(1);
    let near = points.iter().step_by(stride).filter(|point| point.norm_m() <= RADIUS_MAX * side_m);
    sample.clear();
    sample.extend(near);
}

/// Greatest distance of a point from the robot, metres.
pub(crate) fn farthest_m(points: &[Point]) -> f64 {
    points.iter().map(|point| point.norm_m()).fold(0.0, f64::max)
}

/// Cells of this side that points end in when the robot is at a pose.
pub(crate) fn end_cells(points: &[Point], pose: Pose, side_m: f64) -> impl Iterator<Item = CellIndex> {
    let (sin, cos) = sin_cos(pose.heading_rad);
    let per_metre = 1.0 / side_m;
    points.iter().map(move |point| {
        let x = cos * point.x_m - sin * point.y_m + pose.x_m;
        let y = sin * point.x_m + cos * point.y_m + pose.y_m;
        CellIndex::new(floor(x * per_metre), floor(y * per_metre))
    })
}

fn turned(pose: Pose, steps: i32, step_rad: f64) -> Pose {
    Pose::new(pose.x_m, pose.y_m, pose.heading_rad + f64::from(steps) * step_rad)
}

#[inline]
fn moved(cell: CellIndex, (x, y): (i32, i32)) -> CellIndex {
    CellIndex::new(cell.x.wrapping_add(x), cell.y.wrapping_add(y))
}

/// Mean score of cells of the level after a move, 0 … 1.
pub(crate) fn mean_score(read: &mut impl ScoreRead, cells: &[CellIndex], by: (i32, i32)) -> f64 {
    let sum: u64 = cells.iter().map(|cell| u64::from(read.cell(moved(*cell, by)))).sum();
    sum as f64 / (f64::from(u16::MAX) * cells.len() as f64)
}

/// Points after which a bound that cannot reach the floor any more is given up.
const BOUND_CHUNK: usize = 10;

/// Greatest mean score that cells can have after `by` and 0 … 2^halvings - 1 more along each axis, from a level whose
/// cells are 2^halvings times as wide; `None` when that is not above `floor_score`.
pub(crate) fn node_bound(
    read: &mut impl ScoreRead,
    cells: &[CellIndex],
    by: (i32, i32),
    halvings: u32,
    floor_score: f64,
) -> Option<f64> {
    let full = f64::from(u16::MAX) * cells.len() as f64;
    // Score that may be lost before the mean falls to the floor.
    let spare = (1.0 - floor_score) * full;
    let rest = (1 << halvings) - 1;
    let mut lost = 0u64;
    for chunk in cells.chunks(BOUND_CHUNK) {
        for cell in chunk {
            let cell = moved(*cell, by);
            let block = read.block(CellIndex::new(cell.x >> halvings, cell.y >> halvings));
            // From the first cell of a wide one on, all moves stay within it.
            let right = if cell.x & rest == 0 { 0 } else { u16::MAX };
            let up = if cell.y & rest == 0 { 0 } else { u16::MAX };
            let best = block[0].max(block[1] & right).max(block[2] & up).max(block[3] & right & up);
            lost += u64::from(u16::MAX - best);
        }
        if lost as f64 >= spare {
            return None;
        }
    }
    Some(1.0 - lost as f64 / full)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{field::ScoreField, test_room};

    /// Every pose of the lattice, one by one.
    fn best_by_brute_force(
        grid: &flockslam_evidence::TileGrid<Box<flockslam_evidence::Tile>>,
        points: &[Point],
        window: Window,
    ) -> f64 {
        let mut search = CorrelativeSearch::default();
        search.take_sample(points, 0.1);
        let (step_m, step_rad) = (0.1, search.heading_step(0.1));
        let field = test_room::field(grid);
        let mut read = field.reader(Level::Half);
        let (headings, reach) =
            ((window.reach_rad / step_rad).ceil() as i32, (window.reach_m / 0.2).ceil() as i32);
        let mut best = 0.0f64;
        for heading in -headings..=headings {
            search.turn(turned(window.center, heading, step_rad), step_m);
            for (x, y) in (-2 * reach..2 * reach).flat_map(|x| (-2 * reach..2 * reach).map(move |y| (x, y))) {
                best = best.max(mean_score(&mut read, &search.ends, (x, y)));
            }
        }
        best
    }

    #[test]
    fn finds_the_best_pose_of_the_window_and_no_worse_than_trying_all() {
        let grid = test_room::grid(&test_room::ROOM);
        for (truth, off) in [
            (Pose::new(0.4, -0.3, 0.7), Pose::new(0.4, 0.3, 0.3)),
            (Pose::new(1.0, 0.2, -2.0), Pose::new(-0.5, 0.1, -0.2)),
        ] {
            let points = test_room::scan(truth);
            let center =
                Pose::new(truth.x_m + off.x_m, truth.y_m + off.y_m, truth.heading_rad + off.heading_rad);
            let window = Window { center, reach_m: 0.6, reach_rad: 0.35 };
            let mut search = CorrelativeSearch::default();
            let found = search.search(&test_room::field(&grid), &points, window, (center, 0.0), 3).to_vec();
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
    fn a_alternative_that_cannot_be_beaten_and_a_scan_without_points_find_nothing() {
        let grid = test_room::grid(&test_room::ROOM);
        let truth = Pose::new(0.4, -0.3, 0.7);
        let window = Window { center: truth, reach_m: 0.6, reach_rad: 0.35 };
        let mut search = CorrelativeSearch::default();
        assert!(
            search
                .search(&test_room::field(&grid), &test_room::scan(truth), window, (truth, 0.2), 3)
                .is_empty()
        );
        assert!(search.search(&test_room::field(&grid), &[], window, (truth, 0.0), 3).is_empty());
    }
}
