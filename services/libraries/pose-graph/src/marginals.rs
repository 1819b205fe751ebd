//! How uncertain a solved graph is about the motion between two of its nodes: takes edges and the solution, gives covariances.

use crate::cholesky::{Block, BlockCholesky};
use crate::edge::Edge;
use crate::graph::{PoseGraph, from_jacobian, product, to_jacobian};
use flockslam_registration::cloud::Placement;

/// The factorised information of a solved graph.
///
/// ```
/// use flockslam_pose_graph::{Edge, Marginals};
/// use flockslam_registration::cloud::Placement;
///
/// // Two steps of 1 m along x, each uncertain by 0.1 m and 0.01 rad.
/// let edge = |from, to| Edge {
///     from,
///     to,
///     motion: Placement::new(1.0, 0.0, 0.0),
///     information: [100.0, 0.0, 0.0, 100.0, 0.0, 1e4],
/// };
/// let poses = [0.0, 1.0, 2.0].map(|x_m| Placement::new(x_m, 0.0, 0.0));
/// let marginals = Marginals::new(&[edge(0, 1), edge(1, 2)], &poses).expect("all nodes are connected");
/// let [sigma_x_m, sigma_y_m, sigma_rad] = marginals.sigmas(0, 2);
/// assert!((sigma_x_m - 0.02f64.sqrt()).abs() < 1e-9);
/// // The first turn shifts the second step.
/// assert!((sigma_y_m - (0.02f64 + 1e-4).sqrt()).abs() < 1e-9);
/// assert!((sigma_rad - 2e-4f64.sqrt()).abs() < 1e-9);
/// ```
pub struct Marginals<'a> {
    matrix: BlockCholesky,
    poses: &'a [Placement],
}

impl<'a> Marginals<'a> {
    /// Those of these edges at the solution; `None` when a node is not connected with node 0, which is held.
    pub fn new(edges: &[Edge], poses: &'a [Placement]) -> Option<Self> {
        let matrix = PoseGraph::new(poses.len(), edges).factorised(poses)?;
        Some(Self { matrix, poses })
    }

    /// Standard deviations of the pose of node `to` in the axes of node `from`: along x and y, metres, and of its heading, radians.
    pub fn sigmas(&self, from: usize, to: usize) -> [f64; 3] {
        let (of_to, of_from) = (self.columns(to), self.columns(from));
        let jacobians = (from_jacobian(self.poses, from, to), to_jacobian(self.poses, from));
        let (from_block, cross, to_block) =
            (self.block(&of_from, from), self.block(&of_to, from), self.block(&of_to, to));
        let of =
            |left: &Block, middle: &Block, right: &Block| product(&product(left, middle), &transposed(right));
        let (own, mixed, other) = (
            of(&jacobians.0, &from_block, &jacobians.0),
            of(&jacobians.0, &cross, &jacobians.1),
            of(&jacobians.1, &to_block, &jacobians.1),
        );
        [0, 4, 8].map(|i| (own[i] + 2.0 * mixed[i] + other[i]).max(0.0).sqrt())
    }

    /// The columns of the covariance of all nodes that belong to a node.
    fn columns(&self, node: usize) -> [Vec<[f64; 3]>; 3] {
        std::array::from_fn(|axis| {
            let mut column = vec![[0.0; 3]; self.poses.len() - 1];
            if node > 0 {
                column[node - 1][axis] = 1.0;
                self.matrix.substituted(&mut column);
            }
            column
        })
    }

    /// The rows of a node in such columns. Node 0 is held.
    fn block(&self, columns: &[Vec<[f64; 3]>; 3], node: usize) -> Block {
        if node == 0 {
            return [0.0; 9];
        }
        std::array::from_fn(|i| columns[i % 3][node - 1][i / 3])
    }
}

fn transposed(m: &Block) -> Block {
    [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]]
}
