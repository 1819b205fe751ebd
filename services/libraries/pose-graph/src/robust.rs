//! The robust solver: graduated non-convexity with truncated least squares (Yang et al. 2020) over the pose graph. Takes edges, of which the first are not switchable,
//! and start poses; gives poses and a weight for each edge.

use crate::edge::Edge;
use crate::graph::PoseGraph;
use flockslam_registration::cloud::Placement;

/// How a graph is solved; [`solve`] has an example.
#[derive(Clone, Copy, Debug)]
pub struct RobustSettings {
    /// Squared Mahalanobis error from which a loop is an outlier.
    pub chi_squared_max: f64,
    /// Factor by which the cost is made less convex in a round.
    pub growth: f64,
    /// Most rounds.
    pub rounds: usize,
    /// Gauss–Newton steps before the first round, with all loops that are inliers.
    pub warm_up: usize,
}

/// The result of solving a graph.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// A weight for each edge, 0 for loops that are outliers.
    pub weights: Vec<f64>,
    /// Work that it took, products of 3 × 3 blocks.
    pub work: u64,
}

/// Solves a pose graph by graduated non-convexity with truncated least squares (Yang et al. 2020, eq. 14):
/// the edges from number `fixed_count` on are switchable: loops that may be wrong. Poses are the start in, the solution out.
///
/// Edges that are not switchable must connect all nodes. Node 0 stays where it is.
///
/// ```
/// use flockslam_registration::cloud::Placement;
/// use flockslam_pose_graph::{Edge, RobustSettings, solve};
///
/// let edge = |from, to, motion, sigma_m: f64, sigma_rad: f64| {
///     let (t, r) = (sigma_m.powi(-2), sigma_rad.powi(-2));
///     Edge { from, to, motion, information: [t, 0.0, 0.0, t, 0.0, r] }
/// };
/// // Odometry measures each of three metres as 1.05 m.
/// let mut edges: Vec<Edge> =
///     (0..3).map(|k| edge(k, k + 1, Placement::new(1.05, 0.0, 0.0), 0.1, 0.01)).collect();
/// let mut poses: Vec<Placement> = (0..4).map(|k| Placement::new(1.05 * k as f64, 0.0, 0.0)).collect();
/// let fixed_count = edges.len();
/// edges.push(edge(0, 3, Placement::new(3.0, 0.0, 0.0), 0.02, 0.01));
/// // This one is wrong.
/// edges.push(edge(0, 2, Placement::new(0.0, 0.5, 0.0), 0.02, 0.01));
/// let settings = RobustSettings { chi_squared_max: 16.0, growth: 1.6, rounds: 25, warm_up: 6 };
/// let solved = solve(poses.len(), &edges, fixed_count, &settings, &mut poses);
/// assert_eq!(solved.weights[fixed_count..], [1.0, 0.0]);
/// assert!((poses[3].x_m - 3.0).abs() < 0.01);
/// ```
///
/// # Panics
/// When there are fewer poses than nodes, or fewer edges than `fixed_count`.
pub fn solve(
    nodes: usize,
    edges: &[Edge],
    fixed_count: usize,
    settings: &RobustSettings,
    poses: &mut [Placement],
) -> Solved {
    let mut graph = PoseGraph::new(nodes, edges);
    let mut weights = vec![1.0; edges.len()];
    for _ in 0..settings.warm_up {
        if graph.step(&weights, poses) < 1e-4 {
            break;
        }
    }
    let limit = settings.chi_squared_max;
    let worst = edges[fixed_count..].iter().map(|e| e.chi_squared(poses)).fold(0.0, f64::max);
    if worst > limit {
        let mut convexity = limit / (2.0 * worst - limit);
        for _ in 0..settings.rounds {
            let mut undecided = false;
            for (edge, weight) in edges.iter().zip(&mut weights).skip(fixed_count) {
                *weight = truncated(edge.chi_squared(poses), limit, convexity);
                undecided |= *weight > 0.0 && *weight < 1.0;
            }
            graph.step(&weights, poses);
            if !undecided {
                break;
            }
            convexity *= settings.growth;
        }
        // The weights of the last round decide.
        for (edge, weight) in edges.iter().zip(&mut weights).skip(fixed_count) {
            *weight = if edge.chi_squared(poses) <= limit { 1.0 } else { 0.0 };
        }
    }
    for _ in 0..3 {
        if graph.step(&weights, poses) < 1e-6 {
            break;
        }
    }
    Solved { weights, work: graph.work() }
}

/// The weight of an error under the surrogate of the truncated cost.
fn truncated(chi_squared: f64, limit: f64, convexity: f64) -> f64 {
    if chi_squared <= convexity / (convexity + 1.0) * limit {
        1.0
    } else if chi_squared >= (convexity + 1.0) / convexity * limit {
        0.0
    } else {
        ((limit * convexity * (convexity + 1.0) / chi_squared).sqrt() - convexity).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: RobustSettings =
        RobustSettings { chi_squared_max: 16.0, growth: 1.6, rounds: 30, warm_up: 6 };

    fn edge(from: usize, to: usize, motion: Placement, sigma_m: f64, sigma_rad: f64) -> Edge {
        let (t, r) = (1.0 / (sigma_m * sigma_m), 1.0 / (sigma_rad * sigma_rad));
        Edge { from, to, motion, information: [t, 0.0, 0.0, t, 0.0, r] }
    }

    /// Four rounds along a square of 10 m, dead reckoning bent by `bias` radians a metre.
    fn rounds(bias: f64) -> (Vec<Placement>, Vec<Placement>, Vec<Edge>) {
        let step = |k: usize, bias: f64| {
            Placement::new(1.0, 0.0, bias + if k % 10 == 9 { std::f64::consts::FRAC_PI_2 } else { 0.0 })
        };
        let (mut truth, mut bent, mut edges) =
            (vec![Placement::IDENTITY], vec![Placement::IDENTITY], Vec::new());
        for k in 0..160 {
            truth.push(truth[k].compose(step(k, 0.0)));
            bent.push(bent[k].compose(step(k, bias)));
            edges.push(edge(k, k + 1, step(k, bias), 0.02, 0.01));
        }
        (truth, bent, edges)
    }

    #[test]
    fn right_loops_straighten_the_path_and_wrong_ones_do_not_act() {
        let (truth, mut poses, mut edges) = rounds(0.004);
        for k in (40..160).step_by(7) {
            edges.push(edge(k - 40, k, truth[k - 40].to(truth[k]), 0.03, 0.01));
        }
        for k in (45..160).step_by(30) {
            edges.push(edge(k - 38, k, Placement::IDENTITY, 0.03, 0.01));
        }
        let worst_m =
            |poses: &[Placement]| truth.iter().zip(poses).map(|(a, b)| a.distance_m(b)).fold(0.0, f64::max);
        assert!(worst_m(&poses) > 4.0, "the path must need help");
        let step_work = {
            let mut graph = PoseGraph::new(161, &edges);
            graph.step(&vec![1.0; edges.len()], &mut poses.clone());
            graph.work()
        };
        let Solved { weights, work } = solve(161, &edges, 160, &SETTINGS, &mut poses);
        for (edge, weight) in edges.iter().zip(&weights) {
            assert_eq!(*weight, if edge.to - edge.from == 38 { 0.0 } else { 1.0 }, "{edge:?}");
        }
        assert!(worst_m(&poses) < 0.15, "{}", worst_m(&poses));
        // Each of 160 unknowns has a block on the diagonal; the steps of the warm-up, of all rounds and three more.
        assert!(step_work >= 160 && work % step_work == 0, "{work} of {step_work}");
        assert!((3..=6 + 30 + 3).contains(&(work / step_work)), "{work} of {step_work}");
    }

    #[test]
    fn a_consistent_graph_is_solved_exactly() {
        let (truth, mut poses, mut edges) = rounds(0.0);
        for (k, pose) in poses.iter_mut().enumerate().skip(1) {
            *pose = Placement::new(pose.x_m + 0.3 * (k as f64).sin(), pose.y_m - 0.2, pose.heading_rad + 0.1);
        }
        edges.push(edge(0, 160, truth[0].to(truth[160]), 0.03, 0.01));
        solve(161, &edges, 160, &RobustSettings { warm_up: 20, ..SETTINGS }, &mut poses);
        assert!(truth.iter().zip(&poses).all(|(a, b)| a.distance_m(b) < 1e-6 && a.turn_rad(b) < 1e-6));
    }
}
