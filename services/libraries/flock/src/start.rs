//! Start poses for the solver over many trajectories: a spanning tree over the pairs of trajectories, those with most agreeing closures first.

use flockslam_loop_closure::node::Node;
use flockslam_pose_graph::Edge;
use flockslam_registration::cloud::Placement;
use std::collections::BTreeMap;

/// Closures agree on the relative pose of two trajectories when they differ by less than this, metres and radians.
const AGREEING: (f64, f64) = (1.0, 0.15);

/// Pose of one trajectory relative to another, and the number of closures that agree.
#[derive(Clone, Copy)]
struct TrajectoryEdge {
    low: u32,
    high: u32,
    /// Takes the frame of `high` to that of `low`.
    low_from_high: Placement,
    votes: usize,
}

/// Poses to solve a graph of many trajectories from, and by trajectory the first trajectory that it is connected to.
///
/// Trajectories are connected the surest first – a spanning tree of most votes – and each tree is in the frame of its first
/// trajectory. The start matters: from a heading that is quite wrong, no solver finds back.
pub fn start(nodes: &[Node], loops: &[Edge]) -> (Vec<Placement>, Vec<u32>) {
    let count = nodes.last().map_or(0, |node| node.trajectory as usize + 1);
    let mut root: Vec<u32> = (0..count as u32).collect();
    // By trajectory: takes its frame to that of its root.
    let mut root_from: Vec<Placement> = vec![Placement::IDENTITY; count];
    let mut edges_between = edges_between(nodes, loops);
    edges_between.sort_by_key(|edge| (std::cmp::Reverse(edge.votes), edge.low, edge.high));
    for edge in edges_between {
        let (low, high) = (edge.low as usize, edge.high as usize);
        if root[low] == root[high] {
            continue;
        }
        let low_root_from_high_root =
            root_from[low].compose(edge.low_from_high).compose(root_from[high].inverse());
        let (kept, gone, moved) = if root[low] < root[high] {
            (root[low], root[high], low_root_from_high_root)
        } else {
            (root[high], root[low], low_root_from_high_root.inverse())
        };
        for trajectory in 0..count {
            if root[trajectory] == gone {
                root[trajectory] = kept;
                root_from[trajectory] = moved.compose(root_from[trajectory]);
            }
        }
    }
    let poses = nodes.iter().map(|node| root_from[node.trajectory as usize].compose(node.start)).collect();
    (poses, root)
}

/// For each pair of trajectories with closures between them, the motion that most of them agree on.
fn edges_between(nodes: &[Node], loops: &[Edge]) -> Vec<TrajectoryEdge> {
    let mut pairs: BTreeMap<(u32, u32), Vec<(Placement, Placement)>> = BTreeMap::new();
    for edge in loops {
        let (from, to) = (&nodes[edge.from], &nodes[edge.to]);
        if from.trajectory < to.trajectory {
            let moved = from.start.compose(edge.motion).compose(to.start.inverse());
            pairs.entry((from.trajectory, to.trajectory)).or_default().push((moved, to.start));
        } else if to.trajectory < from.trajectory {
            let moved = to.start.compose(edge.motion.inverse()).compose(from.start.inverse());
            pairs.entry((to.trajectory, from.trajectory)).or_default().push((moved, from.start));
        }
    }
    let edge = |((low, high), motions): ((u32, u32), Vec<(Placement, Placement)>)| {
        // Compared where the trajectory was matched: far away a little turn moves it much.
        let votes = |a: &(Placement, Placement)| {
            let agrees = |b: &&(Placement, Placement)| {
                let (here, there) = (a.0.compose(a.1), b.0.compose(a.1));
                here.distance_m(&there) < AGREEING.0 && here.turn_rad(&there) < AGREEING.1
            };
            motions.iter().filter(agrees).count()
        };
        let counted = motions.iter().enumerate().map(|(i, motion)| (votes(motion), std::cmp::Reverse(i)));
        let (votes, std::cmp::Reverse(best)) = counted.max().expect("a pair has a closure");
        TrajectoryEdge { low, high, low_from_high: motions[best].0, votes }
    };
    pairs.into_iter().map(edge).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nodes(connectivity: &[u32]) -> Vec<Node> {
        let node = |(k, trajectory): (usize, &u32)| {
            let at = Placement::new(k as f64, 0.3 * k as f64, 0.1 * k as f64);
            Node {
                scan: k,
                sequence: k as u64,
                odom: at,
                local_pose: at,
                start: at,
                travel_m: k as f64,
                drift_bound_m: k as f64,
                trajectory: *trajectory,
                is_open: false,
                is_given: false,
            }
        };
        connectivity.iter().enumerate().map(node).collect()
    }

    #[test]
    fn trajectories_are_connected_over_others_and_by_the_surest_closures_first() {
        let nodes = nodes(&[0, 0, 1, 1, 1, 2, 2, 2, 3]);
        let frames = [(0.0, 0.0, 0.0), (5.0, -3.0, 2.0), (-8.0, 1.0, -1.0), (1.0, 1.0, 1.0)]
            .map(|(x, y, turn)| Placement::new(x, y, turn));
        let truth = |k: usize| frames[nodes[k].trajectory as usize].compose(nodes[k].start);
        let right = |from: usize, to: usize| Edge {
            from,
            to,
            motion: truth(from).to(truth(to)),
            information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
        };
        // 0 and 1 know each other over 2 alone; a lone lie between them has less weight.
        let lie = Edge { motion: Placement::IDENTITY, ..right(0, 3) };
        let loops = [lie, right(0, 5), right(6, 1), right(7, 2), right(4, 6)];
        let (poses, root) = start(&nodes, &loops);
        assert_eq!(root, [0, 0, 0, 3]);
        for (k, pose) in poses.iter().enumerate().take(8) {
            assert!(pose.distance_m(&truth(k)) < 1e-9 && pose.turn_rad(&truth(k)) < 1e-9, "{k}");
        }
    }
}
