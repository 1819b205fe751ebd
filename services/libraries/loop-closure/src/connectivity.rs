//! Trajectories, the trajectories between which nothing was measured while driving: which of them closures connect, and where each starts in the solver.

use crate::node::Node;
use flockslam_pose_graph::Edge;
use flockslam_registration::cloud::Placement;

/// Closures agree on the relative pose of two trajectories when they differ by less than this, metres and radians.
const AGREEING: (f64, f64) = (1.0, 0.15);

/// Which trajectories are connected by closures.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryConnectivity {
    /// By trajectory: the first trajectory that it is connected with, itself when with none before it.
    root: Vec<u32>,
    /// The root that most nodes are connected with, or that of an imported map: the map.
    main: u32,
}

impl TrajectoryConnectivity {
    /// The trajectories of these nodes as `loops` (pairs of nodes) connect them.
    pub fn new(nodes: &[Node], loops: impl Iterator<Item = (usize, usize)>) -> Self {
        let count = nodes.last().map_or(0, |node| node.trajectory + 1);
        if count == 1 {
            return Self { root: vec![0], main: 0 };
        }
        let mut root: Vec<u32> = (0..count).collect();
        for (a, b) in loops {
            let (a, b) = (root[nodes[a].trajectory as usize], root[nodes[b].trajectory as usize]);
            let (kept, gone) = (a.min(b), a.max(b));
            root.iter_mut().filter(|r| **r == gone).for_each(|r| *r = kept);
        }
        let mut sizes = vec![0usize; count as usize];
        nodes.iter().for_each(|node| sizes[root[node.trajectory as usize] as usize] += 1);
        // An imported map is the map, however much is driven beside it.
        let given = nodes.first().filter(|node| node.is_given).map(|node| root[node.trajectory as usize]);
        let largest = (0..count).max_by_key(|&r| (sizes[r as usize], std::cmp::Reverse(r))).unwrap_or(0);
        Self { root, main: given.unwrap_or(largest) }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.root.len()
    }

    /// The newest.
    pub fn newest(&self) -> u32 {
        self.root.len().saturating_sub(1) as u32
    }

    /// Number of the connected part that a trajectory belongs to: equal for connected trajectories.
    pub fn part(&self, trajectory: u32) -> u32 {
        // A trajectory without a node yet is connected with nothing.
        self.root.get(trajectory as usize).copied().unwrap_or(trajectory)
    }

    /// Whether a trajectory belongs to the map.
    pub fn is_attached(&self, trajectory: u32) -> bool {
        self.part(trajectory) == self.main
    }
}

/// Initial poses for solving a graph: each trajectory at the start poses of its nodes, moved as a whole to where closures place it relative to the
/// trajectories before it.
///
/// The start matters: from a heading that is quite wrong, no solver finds back.
pub fn start(nodes: &[Node], loops: &[Edge]) -> Vec<Placement> {
    let mut poses: Vec<Placement> = nodes.iter().map(|node| node.start).collect();
    for trajectory in nodes.chunk_by(|a, b| a.trajectory == b.trajectory).skip(1) {
        let number = trajectory[0].trajectory;
        let first = nodes.partition_point(|node| node.trajectory < number);
        let end = first + trajectory.len();
        if let Some(moved) = moved(nodes, loops, &poses, number) {
            poses[first..end].iter_mut().for_each(|pose| *pose = moved.compose(*pose));
        }
    }
    poses
}

/// The motion of a trajectory that most of its closures with earlier trajectories agree on.
fn moved(nodes: &[Node], loops: &[Edge], poses: &[Placement], trajectory: u32) -> Option<Placement> {
    let implied = |edge: &Edge| {
        let (from, to) = (nodes[edge.from].trajectory, nodes[edge.to].trajectory);
        if to == trajectory && from < trajectory {
            Some(poses[edge.from].compose(edge.motion).compose(nodes[edge.to].start.inverse()))
        } else if from == trajectory && to < trajectory {
            Some(poses[edge.to].compose(edge.motion.inverse()).compose(nodes[edge.from].start.inverse()))
        } else {
            None
        }
    };
    let motions: Vec<(Placement, Placement)> = loops
        .iter()
        .filter_map(|edge| {
            let inside = if nodes[edge.to].trajectory == trajectory { edge.to } else { edge.from };
            Some((implied(edge)?, nodes[inside].start))
        })
        .collect();
    // Compared where the trajectory was matched: far away a little turn moves it much.
    let agreeing = |a: &(Placement, Placement)| {
        let agrees = |b: &&(Placement, Placement)| {
            let (here, there) = (a.0.compose(a.1), b.0.compose(a.1));
            here.distance_m(&there) < AGREEING.0 && here.turn_rad(&there) < AGREEING.1
        };
        motions.iter().filter(agrees).count()
    };
    let best = motions.iter().enumerate().max_by_key(|(i, motion)| (agreeing(motion), std::cmp::Reverse(*i)));
    best.map(|(_, motion)| motion.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nodes() -> Vec<Node> {
        let node = |k: usize| {
            let at = Placement::new(k as f64, 0.0, 0.0);
            let trajectory = [0, 0, 0, 1, 1, 2, 2, 2, 2, 2][k];
            Node {
                scan: k,
                sequence: k as u64,
                odom: at,
                local_pose: at,
                start: at,
                travel_m: k as f64,
                drift_bound_m: k as f64,
                trajectory,
                is_open: false,
                is_given: false,
            }
        };
        (0..10).map(node).collect()
    }

    fn edge(from: usize, to: usize, motion: Placement) -> Edge {
        Edge { from, to, motion, information: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0] }
    }

    #[test]
    fn closures_connect_trajectories_and_the_largest_part_is_the_map() {
        let alone = TrajectoryConnectivity::new(&nodes(), std::iter::empty());
        assert_eq!((0..3).map(|k| alone.is_attached(k)).collect::<Vec<_>>(), [false, false, true]);
        let joined = TrajectoryConnectivity::new(&nodes(), [(6, 1)].into_iter());
        assert_eq!((0..3).map(|k| joined.is_attached(k)).collect::<Vec<_>>(), [true, false, true]);
        assert_eq!((joined.part(2), joined.part(1), joined.newest(), joined.count()), (0, 1, 2, 3));
        assert!(!joined.is_attached(3), "a trajectory without nodes");
    }

    #[test]
    fn an_imported_map_is_the_map_also_when_it_is_the_smaller_part() {
        let mut nodes = nodes();
        nodes[..3].iter_mut().for_each(|node| node.is_given = true);
        let alone = TrajectoryConnectivity::new(&nodes, std::iter::empty());
        assert_eq!((0..3).map(|k| alone.is_attached(k)).collect::<Vec<_>>(), [true, false, false]);
    }

    #[test]
    fn a_trajectory_starts_where_most_of_its_closures_place_it() {
        let turned = Placement::new(20.0, 5.0, 2.0);
        let nodes = nodes();
        let right = |from: usize, to: usize| {
            edge(from, to, nodes[from].local_pose.to(turned.compose(nodes[to].local_pose)))
        };
        let loops = [edge(0, 5, Placement::IDENTITY), right(1, 6), right(2, 8)];
        let poses = start(&nodes, &loops);
        for (pose, node) in poses.iter().zip(&nodes) {
            let expected =
                if node.trajectory == 2 { turned.compose(node.local_pose) } else { node.local_pose };
            assert!(pose.distance_m(&expected) < 1e-9 && pose.turn_rad(&expected) < 1e-9);
        }
    }
}
