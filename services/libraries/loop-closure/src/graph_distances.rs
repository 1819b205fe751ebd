//! Distances along the graph: how far the odometry may have drifted between two nodes.

use crate::node::Node;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// What a closure adds to a distance along the graph, metres.
pub const CLOSURE_M: f64 = 1.0;
/// What odometry between two trajectories adds, metres: the window behind it reaches 9 m and 0.36 rad.
pub const JOINT_M: f64 = 150.0;

/// Distances along the graph from `from` to every node, metres: along the odometry, and across loops that are inliers.
///
/// `loops` are pairs of nodes with the uncertainty between them as a length of path, metres.
pub fn graph_distances(nodes: &[Node], loops: &[(usize, usize, f64)], from: usize) -> Vec<f64> {
    settled(nodes, loops, from, vec![true; nodes.len()])
}

/// The same for these nodes; what is said of others is too large where they lie farther away than all of these. So a search in a large map
/// need not go through all of it. (Dijkstra 1959.)
pub fn graph_distances_to(
    nodes: &[Node],
    loops: &[(usize, usize, f64)],
    from: usize,
    to: &[usize],
) -> Vec<f64> {
    let mut is_wanted = vec![false; nodes.len()];
    to.iter().for_each(|node| is_wanted[*node] = true);
    settled(nodes, loops, from, is_wanted)
}

fn settled(nodes: &[Node], loops: &[(usize, usize, f64)], from: usize, mut is_wanted: Vec<bool>) -> Vec<f64> {
    let mut across = vec![Vec::new(); nodes.len()];
    for &(a, b, length_m) in loops {
        across[a].push((b, length_m));
        across[b].push((a, length_m));
    }
    let mut distances = vec![f64::INFINITY; nodes.len()];
    let mut wanted = is_wanted.iter().filter(|is_wanted| **is_wanted).count();
    // Whole micrometres order the queue: floats have no total order. So the last node is exact when all of its micrometre are settled.
    let mut last_um = u64::MAX;
    let mut queue = BinaryHeap::new();
    distances[from] = 0.0;
    queue.push((Reverse(0u64), from));
    while let Some((Reverse(um), node)) = queue.pop() {
        if um > last_um {
            break;
        }
        if um > (distances[node] * 1e6) as u64 {
            continue;
        }
        wanted -= usize::from(std::mem::take(&mut is_wanted[node]));
        if wanted == 0 {
            last_um = um;
        }
        let mut relax = |next: usize, step_m: f64| {
            let distance = distances[node] + step_m;
            if distance < distances[next] {
                distances[next] = distance;
                queue.push((Reverse((distance * 1e6) as u64), next));
            }
        };
        let step = |a: usize, b: usize| (nodes[a].drift_bound_m - nodes[b].drift_bound_m).abs();
        if node > 0 {
            relax(node - 1, step(node, node - 1));
        }
        if node + 1 < nodes.len() {
            relax(node + 1, step(node, node + 1));
        }
        for &(next, length_m) in &across[node] {
            relax(next, length_m);
        }
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_random::Random;
    use flockslam_registration::cloud::Placement;

    /// A drive whose drift grows by up to a metre with each node.
    fn nodes(count: usize, random: &mut Random) -> Vec<Node> {
        let mut drift_bound_m = 0.0;
        let pose = Placement::IDENTITY;
        let mut node = |k: usize| {
            drift_bound_m += random.between(0.0, 1.0);
            Node {
                scan: k,
                sequence: k as u64,
                odom: pose,
                local_pose: pose,
                start: pose,
                travel_m: drift_bound_m,
                drift_bound_m,
                trajectory: 0,
                is_open: false,
                is_given: false,
            }
        };
        (0..count).map(&mut node).collect()
    }

    #[test]
    fn distances_to_some_nodes_are_those_to_all_to_the_last_bit() {
        let mut random = Random::new(1, "graph distances");
        let nodes = nodes(400, &mut random);
        let mut pair = || (random.below(400), random.below(400), CLOSURE_M);
        let loops: Vec<_> = (0..40).map(|_| pair()).collect();
        for from in [0, 123, 399] {
            let all = graph_distances(&nodes, &loops, from);
            for to in [vec![], vec![from], vec![7, 250], (100..140).collect()] {
                let some = graph_distances_to(&nodes, &loops, from, &to);
                assert!(to.iter().all(|node| some[*node] == all[*node]));
            }
        }
    }

    #[test]
    fn a_loop_shortens_the_way_between_its_ends() {
        let mut random = Random::new(1, "graph distances");
        let nodes = nodes(100, &mut random);
        let driven_m = nodes[99].drift_bound_m - nodes[0].drift_bound_m;
        assert!((graph_distances(&nodes, &[], 0)[99] - driven_m).abs() < 1e-9);
        assert_eq!(graph_distances(&nodes, &[(0, 99, CLOSURE_M)], 0)[99], CLOSURE_M);
        assert_eq!(graph_distances_to(&nodes, &[(0, 99, CLOSURE_M)], 0, &[99])[50], f64::INFINITY);
    }
}
