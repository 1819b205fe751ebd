//! A matcher that is started again while its robot drives on: scans are lost meanwhile, and wheels slip.

use super::tests::FrontEnd;
use super::*;
use flockslam_messages::ScanBuffer;
use flockslam_simulation::{Settings as Simulated, Simulation, World};

/// The drive whose wheels slip from scan 203 to scan 216: by 0.04 rad from each scan to the next.
fn drive() -> Vec<(ScanBuffer, Pose)> {
    let settings = Simulated { duration_s: 60.0, ..Simulated::default() };
    Simulation::new(&settings, World::built_in(&settings)).unwrap().take(300).collect()
}

/// A front end that has handled these scans, and the poses that it published.
fn driven(scans: &[(ScanBuffer, Pose)]) -> (FrontEnd, Vec<PoseEstimate>) {
    let mut front_end = FrontEnd::new(Settings::default());
    let published = scans.iter().map(|(scan, _)| front_end.step(scan, true)).collect();
    (front_end, published)
}

#[test]
fn wheels_that_slip_while_scans_are_lost_leave_no_false_pose_behind() {
    let drive = drive();
    let start = drive[0].1;
    for (killed_after, lost) in [(195, 15), (195, 20), (199, 30), (205, 10), (207, 20)] {
        let (mut front_end, published) = driven(&drive[..killed_after]);
        front_end.start_again(&published);
        for (scan, truth) in &drive[killed_after + lost..] {
            let estimate = front_end.step(scan, true);
            let off_m = (start * estimate.odom_from_base).distance_m(*truth);
            let is_reported = estimate.quality == Quality::Lost as u32;
            let case = format!("{lost} lost after {killed_after}, {}", scan.header.id.sequence);
            assert!(off_m < 0.15 || is_reported, "{case}: {off_m} m, {estimate:?}");
            assert_eq!(estimate.trajectory, 0, "{case}");
        }
    }
}

#[test]
fn scans_before_the_grid_is_there_leave_no_false_pose_behind_either() {
    let drive = drive();
    let start = drive[0].1;
    let (mut front_end, published) = driven(&drive[..197]);
    front_end.start_again(&published);
    for (number, (scan, truth)) in drive.iter().enumerate().skip(212) {
        let estimate =
            if number < 218 { front_end.step_without_grid(scan) } else { front_end.step(scan, true) };
        let off_m = (start * estimate.odom_from_base).distance_m(*truth);
        let is_reported = estimate.quality != Quality::Tracking as u32;
        assert!(off_m < 0.15 || is_reported, "{number}: {off_m} m, {estimate:?}");
        assert!(number < 232 || off_m < 0.15, "{number}: {off_m} m, {estimate:?}");
    }
}

#[test]
fn the_score_statistics_of_a_predecessor_are_restored() {
    let (mut front_end, published) = driven(&drive()[..150]);
    let before = std::mem::take(&mut front_end.matcher.confidence);
    front_end.start_again(&published);
    let after = &front_end.matcher.confidence;
    assert_eq!((after.matched, after.lost), (before.matched, before.lost));
    assert_eq!((after.mean_score, after.last_score), (before.mean_score, before.last_score));
    assert!(after.has_started() && !after.is_in_the_open());
}
