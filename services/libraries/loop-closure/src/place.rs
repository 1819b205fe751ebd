//! The last step for single scans: each kept scan is matched to the nodes around it, whose poses are final. Takes guesses, gives poses.

use crate::node::Node;
use crate::scans::ScanStore;
use flockslam_registration::cloud::{
    AlignSettings, Aligner, Alignment, MomentGrid, PackedPoint, PlacedPoint, Placement,
};
use std::collections::VecDeque;
use std::ops::Range;

/// Share of points on lines that a match needs.
const INLIERS_MIN: f64 = 0.5;
/// Largest root mean square distance of those from their lines, metres.
const SPREAD_MAX_M: f64 = 0.055;
/// Farthest that a match may move a scan that the front end has matched, metres and radians …
pub const MATCHED_MOVE_MAX: (f64, f64) = (0.15, 0.06);
/// … and one that it has not: odometry that lags behind in a turn is off by several degrees.
pub const DROPPED_MOVE_MAX: (f64, f64) = (0.15, 0.2);

/// A scan to be placed.
#[derive(Clone, Copy, Debug)]
pub struct KeptScan {
    /// Its number in the store.
    pub scan: usize,
    /// Where it is expected, the likelier first.
    pub guesses: [Placement; 2],
    /// Farthest that its match may move from there, metres and radians.
    pub move_max: (f64, f64),
    /// The last node at or before it.
    pub node: usize,
    /// Whether it is that node itself.
    pub is_node: bool,
}

/// Places scans one after the other in a finished solution.
pub struct Placer<'a> {
    /// The nodes.
    pub nodes: &'a [Node],
    /// Their points.
    pub scans: &'a ScanStore,
    /// Poses of the nodes.
    pub poses: &'a [Placement],
    /// A scan is matched to the nodes up to this many before and after it.
    pub reach: usize,
}

impl Placer<'_> {
    /// Places `kept`, which are in order. `grid` is lent empty and given back so.
    pub fn place_all(&self, kept: &[KeptScan], grid: &mut MomentGrid) -> Vec<Placement> {
        let aligner =
            Aligner::new(AlignSettings { iterations: 6, is_quick: true, ..AlignSettings::default() });
        let Some(first) = kept.first().map(|scan| self.around(scan.node).start) else { return Vec::new() };
        let mut held = Held { nodes: first..first, points: VecDeque::new() };
        let mut placed = Vec::with_capacity(kept.len());
        for scan in kept {
            self.slide(&mut held, self.around(scan.node), grid);
            // A node must not be matched to itself: it would stay where it is.
            if scan.is_node {
                grid.withdraw_placed(held.of(scan.node));
            }
            let node = &self.nodes[scan.node];
            placed.push(if node.is_given && scan.is_node {
                self.poses[scan.node]
            } else if node.is_open {
                scan.guesses[0]
            } else {
                place(&aligner, grid, self.scans.points(scan.scan), scan)
            });
            if scan.is_node {
                grid.add_placed(held.of(scan.node));
            }
        }
        let end = held.nodes.end;
        self.slide(&mut held, end..end, grid);
        placed
    }

    /// The nodes that a scan behind `node` is matched to: none of another trajectory.
    fn around(&self, node: usize) -> Range<usize> {
        let trajectory = self.nodes[node].trajectory;
        let first = self.nodes.partition_point(|node| node.trajectory < trajectory);
        let end = self.nodes.partition_point(|node| node.trajectory <= trajectory);
        node.saturating_sub(self.reach).max(first)..(node + self.reach + 1).min(end)
    }

    /// Moves the range of nodes in the grid forward.
    fn slide(&self, held: &mut Held, wanted: Range<usize>, grid: &mut MomentGrid) {
        for i in held.nodes.end..wanted.end {
            let points = self.scans.points(self.nodes[i].scan).iter();
            let placed: Vec<_> = points.map(|point| PlacedPoint::new(&self.poses[i], *point)).collect();
            grid.add_placed(&placed);
            held.points.push_back(placed);
        }
        for _ in held.nodes.start..wanted.start {
            held.points.pop_front().iter().for_each(|placed| grid.withdraw_placed(placed));
        }
        held.nodes = wanted;
    }
}

/// The nodes in the grid, with their points at their places.
struct Held {
    nodes: Range<usize>,
    points: VecDeque<Vec<PlacedPoint>>,
}

impl Held {
    /// The points of a node in the grid.
    fn of(&self, node: usize) -> &[PlacedPoint] {
        &self.points[node - self.nodes.start]
    }
}

/// The first accepted match, else the first guess.
fn place(aligner: &Aligner, grid: &mut MomentGrid, points: &[PackedPoint], scan: &KeptScan) -> Placement {
    // The second guess may be the first one again.
    let [first, second] = &scan.guesses;
    let guesses = std::iter::once(first).chain(Some(second).filter(|second| *second != first));
    let mut attempts = guesses.filter_map(|guess| {
        let found = aligner.align(grid, points, *guess)?;
        is_accepted(&found, guess, scan.move_max).then_some(found.placement)
    });
    attempts.next().unwrap_or(*first)
}

fn is_accepted(found: &Alignment, guess: &Placement, move_max: (f64, f64)) -> bool {
    found.inliers >= INLIERS_MIN
        && found.spread_m <= SPREAD_MAX_M
        && found.placement.distance_m(guess) <= move_max.0
        && found.placement.turn_rad(guess) <= move_max.1
}
