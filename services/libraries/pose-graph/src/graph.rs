//! The pose graph as a least-squares problem: linearises all edges at given poses and does Gauss–Newton steps with the sparse Cholesky factorisation.

use crate::cholesky::{Block, BlockCholesky};
use crate::edge::Edge;
use crate::symmetric::{Symmetric, times};
use flockslam_registration::cloud::Placement;

/// A pose graph ready to be solved: edges with a fixed pattern, node 0 held.
///
/// ```
/// use flockslam_registration::cloud::Placement;
/// use flockslam_pose_graph::{Edge, PoseGraph};
///
/// let information = [400.0, 0.0, 0.0, 400.0, 0.0, 1e4];
/// let edge = |from, to, x_m| Edge { from, to, motion: Placement::new(x_m, 0.0, 0.0), information };
/// // Two steps of 1 m, which a third measurement, as certain as each of them, finds to be 2.3 m together.
/// let edges = [edge(0, 1, 1.0), edge(1, 2, 1.0), edge(0, 2, 2.3)];
/// let mut poses = [0.0, 1.0, 2.0].map(|x_m| Placement::new(x_m, 0.0, 0.0));
/// let mut graph = PoseGraph::new(poses.len(), &edges);
/// for _ in 0..3 {
///     graph.step(&[1.0; 3], &mut poses);
/// }
/// // Each takes a third of the difference.
/// assert!((poses[1].x_m - 1.1).abs() < 1e-9 && (poses[2].x_m - 2.2).abs() < 1e-9);
/// ```
pub struct PoseGraph<'a> {
    edges: &'a [Edge],
    matrix: BlockCholesky,
    vector: Vec<[f64; 3]>,
    steps: u64,
}

impl<'a> PoseGraph<'a> {
    /// The graph of these edges over `nodes` nodes. Each edge connects two different ones of them.
    pub fn new(nodes: usize, edges: &'a [Edge]) -> Self {
        // Node 0 is the gauge; the others are unknown k = node - 1.
        let inner = edges.iter().filter(|e| e.from > 0 && e.to > 0);
        let links: Vec<_> = inner.map(|e| (e.from - 1, e.to - 1)).collect();
        let unknowns = nodes.saturating_sub(1);
        Self {
            edges,
            matrix: BlockCholesky::new(unknowns, &links),
            vector: vec![[0.0; 3]; unknowns],
            steps: 0,
        }
    }

    /// Work of all steps so far, products of 3 × 3 blocks.
    pub fn work(&self) -> u64 {
        self.steps * self.matrix.work()
    }

    /// One Gauss–Newton step with these weights on the edges; gives the largest change of a coordinate
    /// (metres or radians). Poses stay as they are, and it gives 0, when the system cannot be solved: then a node is not connected
    /// with node 0 by edges of positive weight.
    ///
    /// # Panics
    /// When there is no pose at all, or an edge names a node that has none.
    pub fn step(&mut self, weights: &[f64], poses: &mut [Placement]) -> f64 {
        self.steps += 1;
        self.linearise(weights, poses);
        if !self.matrix.solve(&mut self.vector) {
            return 0.0;
        }
        let mut largest = 0.0f64;
        for (pose, delta) in poses[1..].iter_mut().zip(&self.vector) {
            *pose = Placement::new(pose.x_m + delta[0], pose.y_m + delta[1], pose.heading_rad + delta[2]);
            largest = delta.iter().fold(largest, |most, d| most.max(d.abs()));
        }
        largest
    }

    /// The factorised information at these poses; `None` when a node is not connected with node 0.
    pub(crate) fn factorised(mut self, poses: &[Placement]) -> Option<BlockCholesky> {
        self.linearise(&vec![1.0; self.edges.len()], poses);
        self.matrix.factor().then_some(self.matrix)
    }

    fn linearise(&mut self, weights: &[f64], poses: &[Placement]) {
        self.matrix.clear();
        self.vector.fill([0.0; 3]);
        for (edge, &weight) in self.edges.iter().zip(weights) {
            if weight > 0.0 {
                self.add(edge, weight, poses);
            }
        }
    }

    /// Linearises one edge: e = Rᵢᵀ(tⱼ - tᵢ) - t, θⱼ - θᵢ - θ.
    fn add(&mut self, edge: &Edge, weight: f64, poses: &[Placement]) {
        let (from_jacobian, to_jacobian) =
            (from_jacobian(poses, edge.from, edge.to), to_jacobian(poses, edge.from));
        let information = edge.information.map(|v| v * weight);
        let error = edge.error(poses);
        let weighted = times(&information, &error);
        let (from_rows, to_rows) = (left(&from_jacobian, &information), left(&to_jacobian, &information));
        if edge.from > 0 {
            let k = edge.from - 1;
            self.matrix.add_diagonal(k, &product(&from_rows, &from_jacobian));
            take(&mut self.vector[k], &from_jacobian, &weighted);
        }
        if edge.to > 0 {
            let k = edge.to - 1;
            self.matrix.add_diagonal(k, &product(&to_rows, &to_jacobian));
            take(&mut self.vector[k], &to_jacobian, &weighted);
        }
        if edge.from > 0 && edge.to > 0 {
            self.matrix.add_link(edge.to - 1, edge.from - 1, &product(&to_rows, &from_jacobian));
        }
    }
}

/// How the pose of node `to` in the axes of node `from` changes with that of `to`.
pub(crate) fn to_jacobian(poses: &[Placement], from: usize) -> Block {
    let (cos, sin) = poses[from].rotate(1.0, 0.0);
    [cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0]
}

/// How it changes with that of `from`.
pub(crate) fn from_jacobian(poses: &[Placement], from: usize, to: usize) -> Block {
    let (cos, sin) = poses[from].rotate(1.0, 0.0);
    let seen = poses[from].to(poses[to]);
    [-cos, -sin, seen.y_m, sin, -cos, -seen.x_m, 0.0, 0.0, -1.0]
}

/// `Jᵀ·Ω`.
fn left(jacobian: &Block, information: &Symmetric) -> Block {
    let mut out = [0.0; 9];
    for column in 0..3 {
        let row = times(information, &[jacobian[column], jacobian[3 + column], jacobian[6 + column]]);
        out[3 * column..3 * column + 3].copy_from_slice(&row);
    }
    out
}

/// `a·b`.
pub(crate) fn product(a: &Block, b: &Block) -> Block {
    std::array::from_fn(|i| {
        let (r, c) = (i / 3, i % 3);
        a[3 * r] * b[c] + a[3 * r + 1] * b[3 + c] + a[3 * r + 2] * b[6 + c]
    })
}

/// `vector -= Jᵀ·e`.
fn take(vector: &mut [f64; 3], jacobian: &Block, e: &[f64; 3]) {
    for (c, value) in vector.iter_mut().enumerate() {
        *value -= jacobian[c] * e[0] + jacobian[3 + c] * e[1] + jacobian[6 + c] * e[2];
    }
}
