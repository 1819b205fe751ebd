//! A loop closure: a measured motion from a segment to a node that came back to it.

use flockslam_pose_graph::Edge;

/// A closure whose squared Mahalanobis error exceeds this in the solved graph is an outlier: 1 in 900 right ones does, by chance.
pub const CHI_SQUARED_MAX: f64 = 16.0;

/// A loop that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closure {
    /// The constraint, from a node of the segment to the query's node.
    pub edge: Edge,
    /// Reach of the window in which it was found, metres.
    pub reach_m: f64,
    /// How far from where it was expected it was found, metres; 0 when nothing was known.
    pub shift_m: f64,
}
