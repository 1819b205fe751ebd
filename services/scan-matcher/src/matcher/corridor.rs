//! A straight corridor without features, then its end: what the scan cannot tell is left to odometry.

use super::tests::FrontEnd;
use super::*;
use crate::settings::Strategy;
use flockslam_geometry::Covariance;
use flockslam_messages::ScanBuffer;

/// Where the corridor, 2 m wide and open behind, ends.
const END_M: f64 = 24.03;
/// The lidar's reach.
const REACH_M: f64 = 8.0;
/// Odometry measures this share of the true distance.
const ODOMETRY: f64 = 0.97;

fn noise(state: &mut u64) -> f64 {
    let mut uniform = || {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 40) as f64 / (1u64 << 24) as f64
    };
    0.01 * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0)
}

/// The robot at (x, y, heading): 1.07 m to its left wall at y = 0, 0.96 m to its right one, 1 cm of noise.
fn look(sequence: u64, pose: Pose, odometry: Pose, state: &mut u64) -> ScanBuffer {
    let range = |i: u32| {
        let (sin, cos) = (pose.heading_rad - 3.0 + 0.02 * f64::from(i)).sin_cos();
        let side = if sin > 0.0 { (1.07 - pose.y_m) / sin } else { (0.96 + pose.y_m) / -sin };
        let end = if cos > 0.0 { (END_M - pose.x_m) / cos } else { f64::INFINITY };
        let range = side.min(end);
        if range < REACH_M { range + noise(state) } else { f64::INFINITY }
    };
    let ranges: Vec<f32> = (0..300).map(range).map(|range| range as f32).collect();
    let mut scan = ScanBuffer::from_ranges(&ranges, -3.0, 0.02);
    scan.header.range_max_m = REACH_M as f32;
    scan.header.id.sequence = sequence;
    scan.header.times.sensor_ns = 100_000_000 * sequence as i64;
    (scan.header.odometry, scan.header.has_odometry) = (odometry, 1);
    scan
}

fn truth(i: u64) -> Pose {
    let x = 0.1 * i as f64;
    Pose::new(x, 0.2 * (0.7 * x).sin(), 0.14 * (0.7 * x).cos())
}

#[test]
fn along_a_corridor_odometry_is_followed_and_across_it_the_walls() {
    for strategy in [Strategy::GaussNewton] {
        let mut front_end = FrontEnd::new(Settings { strategy, ..Settings::default() });
        let (mut state, mut odometry, mut last) = (1, truth(0), truth(0));
        for i in 0..220 {
            if i > 0 {
                let step = truth(i - 1).to(truth(i));
                odometry = odometry * Pose::new(ODOMETRY * step.x_m, step.y_m, step.heading_rad);
            }
            let estimate = front_end.step(&look(i, truth(i), odometry, &mut state), true);
            let pose = truth(0) * estimate.odom_from_base;
            let in_corridor = truth(i).x_m + REACH_M < END_M;
            let along = pose.x_m - truth(i).x_m;
            assert!((pose.y_m - truth(i).y_m).abs() < 0.05, "{strategy:?} {i}: {pose:?}");
            assert!(pose.turn_rad(truth(i)) < 0.01, "{strategy:?} {i}: {pose:?} for {:?}", truth(i));
            if in_corridor && i > 0 {
                let slipped = (ODOMETRY - 1.0) * truth(i).x_m;
                assert!((along - slipped).abs() < 0.1, "{strategy:?} {i}: {along} for {slipped}");
                assert_eq!(estimate.quality, Quality::Degraded as u32, "{strategy:?} {i}");
                // The odom frame is turned by the first heading.
                let (sin, cos) = truth(0).heading_rad.sin_cos();
                let Covariance { xx, xy, yy, .. } = estimate.covariance;
                let across = sin * sin * xx + 2.0 * sin * cos * xy + cos * cos * yy;
                assert!(xx > 0.002 && across < 0.0001, "{i}: {:?}", estimate.covariance);
            }
            assert!(i == 0 || (last.distance_m(pose) - 0.1).abs() < 0.06, "{strategy:?} {i}: no jump");
            last = pose;
        }
    }
}
