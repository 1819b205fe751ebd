//! Segments: stretches of the trajectory, a few metres long, as clouds of points that scans are matched against; and the clouds of single scans.

use crate::node::Node;
use crate::scans::{ScanStore, cloud_points};
use flockslam_registration::cloud::{MomentGrid, PackedPoint, Placement};
use std::ops::Range;

/// Points farther than this from their node are left out of clouds and segments, metres.
pub const CLOUD_RANGE_M: f64 = 15.0;

/// Length of travel in a segment, metres.
const LENGTH_M: f64 = 5.0;
/// Most nodes of a segment: a robot that turns on the spot makes nodes without travel.
const NODES_MAX: usize = 64;

/// A piece of the trajectory, a few metres long, that closures are measured against.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// Its nodes.
    pub nodes: Range<usize>,
    /// The node in its middle, whose frame the segment's points are given in.
    pub anchor: usize,
}

impl Segment {
    /// The segment of these nodes.
    pub fn new(nodes: Range<usize>) -> Self {
        let anchor = (nodes.start + nodes.end) / 2;
        Self { nodes, anchor }
    }

    /// Cuts `nodes[from..]` into segments of 5 m of travel each; the rest that is too short stays for
    /// later.
    pub fn cut(nodes: &[Node], from: usize) -> Vec<Segment> {
        let mut segments = Vec::new();
        let mut start = from;
        for end in from..nodes.len() {
            let breaks = nodes[end].trajectory != nodes[start].trajectory;
            if breaks || nodes[end].travel_m - nodes[start].travel_m >= LENGTH_M || end - start >= NODES_MAX {
                segments.push(Segment::new(start..end));
                start = end;
            }
        }
        segments
    }

    /// The points of the segment in its anchor's frame, one per cell.
    pub fn cloud(&self, nodes: &[Node], scans: &ScanStore) -> Vec<(f64, f64)> {
        cloud(nodes, scans, self.nodes.clone(), self.anchor)
    }
}

/// The points of some nodes, near them, in the frame of node `origin` by the odometry, the mean of each cell of
/// 0.1 m.
pub fn cloud(nodes: &[Node], scans: &ScanStore, range: Range<usize>, origin: usize) -> Vec<(f64, f64)> {
    let mut points = Vec::new();
    for node in &nodes[range] {
        let at = nodes[origin].local_pose.to(node.local_pose);
        points.extend(cloud_points(scans.points(node.scan)).map(|p| at.apply(p.x_m(), p.y_m())));
    }
    cell_means(&points)
}

/// The points of one scan near the robot, in its frame, the mean of each cell of 0.1 m.
pub fn scan_cloud(points: &[PackedPoint]) -> Vec<(f64, f64)> {
    cell_means(&cloud_points(points).map(|p| (p.x_m(), p.y_m())).collect::<Vec<_>>())
}

/// The mean of the points in each cell of 0.1 m, in order of cells.
pub fn cell_means(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let key = |v: f64| (v * (1.0 / MomentGrid::CELL_M)).floor() as i32;
    let mut cells: Vec<(i32, i32, usize)> =
        points.iter().enumerate().map(|(i, &(x, y))| (key(y), key(x), i)).collect();
    cells.sort_unstable();
    let mut means = Vec::new();
    for group in cells.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let share = 1.0 / group.len() as f64;
        let sum = group.iter().fold((0.0, 0.0), |s, g| (s.0 + points[g.2].0, s.1 + points[g.2].1));
        means.push((sum.0 * share, sum.1 * share));
    }
    means
}

/// At most `most` of the points, evenly picked.
pub fn picked(points: &[(f64, f64)], most: usize) -> Vec<(f64, f64)> {
    let stride = points.len().div_ceil(most).max(1);
    points.iter().step_by(stride).copied().collect()
}

/// Points in metres, packed; those too far are left out.
pub fn packed(points: &[(f64, f64)]) -> Vec<PackedPoint> {
    points.iter().filter_map(|&(x, y)| PackedPoint::from_metres(x, y)).collect()
}

/// Brings the points of some nodes into a grid, at the poses that `at` gives.
pub fn load(
    grid: &mut MomentGrid,
    nodes: &[Node],
    scans: &ScanStore,
    range: Range<usize>,
    at: impl Fn(usize) -> Placement,
) {
    range.for_each(|i| grid.add(&at(i), scans.points(nodes[i].scan)));
}

/// Removes the points that [`load`] with the same arguments has added.
pub fn unload(
    grid: &mut MomentGrid,
    nodes: &[Node],
    scans: &ScanStore,
    range: Range<usize>,
    at: impl Fn(usize) -> Placement,
) {
    range.for_each(|i| grid.withdraw(&at(i), scans.points(nodes[i].scan)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_follow_each_other_without_gap() {
        let node = |k: usize| Node {
            scan: k,
            sequence: k as u64,
            odom: Placement::IDENTITY,
            start: Placement::IDENTITY,
            local_pose: Placement::new(0.3 * k as f64, 0.0, 0.0),
            travel_m: 0.3 * k as f64,
            drift_bound_m: 0.0,
            trajectory: u32::from(k >= 30),
            is_open: false,
            is_given: false,
        };
        let nodes: Vec<_> = (0..60).map(node).collect();
        let segments = Segment::cut(&nodes, 4);
        assert_eq!(segments.len(), 3);
        assert!(segments.iter().any(|s| s.nodes.end == 30), "no segment spans two trajectories");
        assert!(
            segments[0].nodes.start == 4 && segments.windows(2).all(|w| w[0].nodes.end == w[1].nodes.start)
        );
    }

    #[test]
    fn cells_hold_the_mean_of_their_points() {
        let means = cell_means(&[(0.02, 0.01), (0.06, 0.03), (-0.01, 0.0)]);
        assert_eq!(means.len(), 2);
        assert!((means[1].0 - 0.04).abs() < 1e-12 && (means[1].1 - 0.02).abs() < 1e-12);
    }
}
