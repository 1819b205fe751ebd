//! Smooths the odometry behind the robot: takes two successive segments, matches the nodes of the first to the second, which has seen the
//! same surfaces later, and gives the local poses of both. Each node was matched to those before it when it was new: this is a second
//! measurement of its motion, over some metres at once.

use crate::node::Node;
use crate::scans::ScanStore;
use crate::segment::Segment;
use crate::segment_matcher::{ROBUST, SegmentMatcher};
use flockslam_pose_graph::{Edge, solve};
use flockslam_registration::cloud::{MomentGrid, Placement};

/// Nodes within this of the second segment are matched to it, metres. With 4 m published poses of Intel were off by a twentieth more.
const NEAR_M: f64 = 3.0;
/// Errors of a match beyond those of its points, metres and radians: half of what is left for segments of different visits, since
/// this one has just been driven.
const SLACK: (f64, f64) = (0.02, 0.005);

/// Local poses of the nodes of two successive segments of one trajectory. The first node stays. `edges` are the odometry edges of all
/// `nodes`; `grid` is empty before and after.
pub(crate) fn smoothed(
    nodes: &[Node],
    edges: &[Edge],
    scans: &ScanStore,
    [first, second]: [&Segment; 2],
    grid: &mut MomentGrid,
) -> Vec<Placement> {
    assert_eq!(first.nodes.end, second.nodes.start, "segments that are smoothed follow each other");
    let (start, end) = (first.nodes.start, second.nodes.end);
    let at = |node: usize| nodes[node].local_pose;
    let is_near = |node: &usize| second.nodes.clone().any(|other| at(other).distance_m(&at(*node)) <= NEAR_M);
    let mut local = edges[start..end - 1].to_vec();
    let odometry = local.len();
    let matcher = SegmentMatcher::new(nodes, scans, SLACK);
    local.extend(matcher.constraints(grid, second, first.nodes.clone().filter(is_near), at));
    for edge in &mut local {
        (edge.from, edge.to) = (edge.from - start, edge.to - start);
    }
    let mut poses: Vec<Placement> = (start..end).map(at).collect();
    solve(poses.len(), &local, odometry, &ROBUST, &mut poses);
    poses
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::NewNode;
    use crate::odometry_graph::OdometryGraph;
    use flockslam_geometry::Twist;
    use flockslam_messages::ScanBuffer;
    use flockslam_random::Random;

    /// Ranges in a room of 16 m × 10 m, with the noise of a lidar, from this pose.
    fn scan(at: &Placement, random: &mut Random) -> ScanBuffer {
        let mut range = |degrees: u32| {
            let (sin, cos) = (at.heading_rad + f64::from(degrees).to_radians()).sin_cos();
            let x_m = (8.0 * cos.signum() - at.x_m) / cos;
            let y_m = (5.0 * sin.signum() - at.y_m) / sin;
            (x_m.min(y_m) + random.between(-0.02, 0.02)) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(&mut range).collect::<Vec<_>>(), 0.0, 1f64.to_radians())
    }

    #[test]
    fn a_bend_in_the_odometry_between_two_segments_is_straightened() {
        let mut random = Random::new(1, "smoothing");
        let truth = |k: usize| Placement::new(-4.9 + 0.3 * k as f64, 0.5, 0.0);
        let (mut graph, mut scans) = (OdometryGraph::default(), ScanStore::default());
        for k in 0..34 {
            let buffer = scan(&truth(k), &mut random);
            let view = buffer.view().unwrap();
            let new = NewNode {
                sequence: k as u64,
                scan: scans.keep(view, Twist::default(), &[], false),
                odom: truth(k),
                trajectory: 0,
                odometry: None,
                continues: false,
                is_open: false,
                is_given: false,
                sigmas: (0.0, 0.0),
            };
            graph.extend(new, &scans);
        }
        // The match of the first node of the second segment was off: what follows is displaced and turned.
        let (mut nodes, mut edges) = (graph.nodes().to_vec(), graph.edges().to_vec());
        let off = Placement::new(0.0, 0.03, 0.02);
        edges[16].motion = edges[16].motion.compose(off);
        for i in 17..34 {
            nodes[i].local_pose = nodes[i - 1].local_pose.compose(edges[i - 1].motion);
        }
        let segments = [&Segment::new(0..17), &Segment::new(17..34)];
        let poses = smoothed(&nodes, &edges, &scans, segments, &mut MomentGrid::default());
        let bent_rad = nodes[33].local_pose.turn_rad(&nodes[0].local_pose);
        let left_rad = poses[33].turn_rad(&poses[0]);
        assert!(poses[0] == nodes[0].local_pose);
        assert!(bent_rad > 0.018 && left_rad < 0.5 * bent_rad, "{bent_rad} rad before, {left_rad} rad after");
    }
}
