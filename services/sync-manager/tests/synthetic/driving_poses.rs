//! The poses that a robot drives by: the front end's, with the correction that the back end knew at each scan.

use super::support::{Building, Noise, drifting, laps};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, ScanId, SubmapClosed};
use flockslam_sync_manager::{Settings, SyncManager};

/// Scans of a submap: 8 m of travel.
const SUBMAP_SCANS: usize = 80;
/// How the front end bends and stretches the way: a decimetre and more over a submap.
const DRIFT: (f64, f64) = (0.004, 1.01);

/// The worst error of one drive depends on the noise of its scans.
const SEEDS: [u64; 6] = [7, 8, 9, 10, 11, 12];

/// Errors of the driven poses, metres, by scan; the back end is queried at each accepted scan, or at closed submaps only.
fn driven_errors_m(at_each_scan: bool, seed: u64) -> Vec<f64> {
    let (building, truth) = (Building::ring(), laps(2));
    let odom = drifting(&truth, DRIFT.0, DRIFT.1);
    let (mut manager, mut noise) = (SyncManager::new(Settings::default()), Noise(seed));
    let (mut map_from_odom, mut revision) = (Pose::IDENTITY, 0);
    let mut errors_m = Vec::new();
    for (i, (at, odom)) in truth.iter().zip(&odom).enumerate() {
        errors_m.push((map_from_odom * *odom).distance_m(*at));
        let id = ScanId { sequence: i as u64, ..ScanId::default() };
        let submap = (i / SUBMAP_SCANS) as u32;
        let accepted = i % 2 == 0;
        let flags = PoseFlags::MATCHED | if accepted { PoseFlags::INSERT } else { 0 };
        let pose = PoseEstimate { id, odom_from_base: *odom, submap, flags, ..PoseEstimate::default() };
        manager.pose(&pose);
        manager.node(building.scan(*at, &mut noise).view().unwrap(), &pose, &[]);
        let mut corrections = Vec::new();
        if accepted && at_each_scan {
            corrections.push(manager.scan_accepted(id));
            assert_eq!(corrections[0].scan, i as u64, "it is named by its scan");
        }
        if i % SUBMAP_SCANS == SUBMAP_SCANS - 1 {
            corrections.push(manager.submap_closed(&SubmapClosed {
                last: id,
                number: submap,
                ..SubmapClosed::default()
            }));
        }
        for correction in corrections {
            assert!(correction.revision >= revision, "revisions only rise");
            (map_from_odom, revision) = (correction.map_from_odom, correction.revision);
        }
    }
    errors_m
}

#[test]
fn a_drifting_front_end_is_corrected_at_each_node_and_better_where_it_has_been() {
    let worst = |errors_m: &[f64]| errors_m.iter().copied().fold(0.0, f64::max);
    let late_m = worst(&driven_errors_m(false, SEEDS[0]));
    assert!(late_m > 0.15, "between closed submaps the front end must drift: {late_m} m");
    let drives = SEEDS.map(|seed| driven_errors_m(true, seed));
    let mean = |of: &dyn Fn(&[f64]) -> f64| {
        drives.iter().map(|errors_m| of(errors_m)).sum::<f64>() / drives.len() as f64
    };
    let worst_m = mean(&|errors_m| worst(errors_m));
    // From some metres behind the start of the second lap: the closure needs others that agree.
    let known = laps(1).len();
    let known_m = mean(&|errors_m| worst(&errors_m[known..]));
    assert!(worst_m < 0.08, "{worst_m} m off, at closed submaps {late_m} m");
    assert!(known_m < 0.04, "{known_m} m off where the robot has been, {worst_m} m before");
}
