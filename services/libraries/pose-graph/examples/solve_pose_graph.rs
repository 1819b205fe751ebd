//! Solves a small pose graph: a robot drives once around a square, its odometry drifts, and of two loop closures one is wrong.
//!
//! `cargo run -p flockslam-sync-manager --example solve_pose_graph` prints the poses before and after, and which closures act.

use flockslam_pose_graph::{Edge, RobustSettings, Solved, solve};
use flockslam_registration::cloud::Placement;
use std::f64::consts::FRAC_PI_2;

/// Steps of a metre along each side of the square.
const SIDE: usize = 10;
/// The last pose is the first again.
const POSES: usize = 4 * SIDE + 1;
/// Odometry takes each step for longer by this share, and bends it by this much, radians.
const DRIFT: (f64, f64) = (0.01, 0.004);

fn main() {
    let mut truth = vec![Placement::IDENTITY];
    let mut by_odometry = vec![Placement::IDENTITY];
    let mut edges = Vec::new();
    for k in 0..POSES - 1 {
        let turn_rad = if k % SIDE == SIDE - 1 { FRAC_PI_2 } else { 0.0 };
        truth.push(truth[k].compose(Placement::new(1.0, 0.0, turn_rad)));
        let measured = Placement::new(1.0 + DRIFT.0, 0.0, turn_rad + DRIFT.1);
        by_odometry.push(by_odometry[k].compose(measured));
        edges.push(edge(k, k + 1, measured, 0.05, 0.01));
    }
    // Odometry edges are not switchable: odometry drifts, but does not jump. The edges after them may be outliers.
    let fixed_count = edges.len();
    let right = edge(0, POSES - 1, truth[0].to(truth[POSES - 1]), 0.02, 0.01);
    // Two places on different sides of the square look the same.
    let wrong = edge(3, 17, Placement::IDENTITY, 0.02, 0.01);
    edges.extend([right, wrong]);

    let settings = RobustSettings { chi_squared_max: 16.0, growth: 1.6, rounds: 25, warm_up: 6 };
    let mut poses = by_odometry.clone();
    let Solved { weights, work } = solve(POSES, &edges, fixed_count, &settings, &mut poses);

    println!("pose        truth, m     odometry, m       solved, m");
    for k in (0..POSES).step_by(SIDE / 2) {
        println!("{k:4} {} {} {}", shown(&truth[k]), shown(&by_odometry[k]), shown(&poses[k]));
    }
    for (edge, weight) in edges.iter().zip(&weights).skip(fixed_count) {
        let verdict = if *weight > 0.5 { "inlier, acts" } else { "outlier, does not act" };
        let chi_squared = edge.chi_squared(&poses);
        println!("closure {} - {}: {verdict}; chi-squared {chi_squared:.2}", edge.from, edge.to);
    }
    let end_m = |poses: &[Placement]| poses[POSES - 1].distance_m(&truth[POSES - 1]);
    let worst_m =
        |poses: &[Placement]| poses.iter().zip(&truth).map(|(a, b)| a.distance_m(b)).fold(0.0, f64::max);
    println!("error at the end: {:.3} m by odometry, {:.3} m solved", end_m(&by_odometry), end_m(&poses));
    println!("largest error: {:.3} m by odometry, {:.3} m solved", worst_m(&by_odometry), worst_m(&poses));
    println!("work: {work} products of 3 × 3 blocks");

    assert!(end_m(&by_odometry) > 1.0, "odometry must need help");
    assert_eq!(weights[fixed_count..], [1.0, 0.0], "the right closure acts, the wrong one does not");
    assert!(end_m(&poses) < 0.03, "the end is where the way began");
    assert!(worst_m(&poses) < 0.2, "what is left in between is the error of the step's length");
}

/// A measured motion with independent errors of these standard deviations, metres and radians.
fn edge(from: usize, to: usize, motion: Placement, sigma_m: f64, sigma_rad: f64) -> Edge {
    let (t, r) = (1.0 / (sigma_m * sigma_m), 1.0 / (sigma_rad * sigma_rad));
    Edge { from, to, motion, information: [t, 0.0, 0.0, t, 0.0, r] }
}

fn shown(pose: &Placement) -> String {
    format!("({:6.2}, {:6.2})", pose.x_m, pose.y_m)
}
