//! A robot in synthetic buildings: what the back end makes of a front end that drifts, jumps or is fooled.

use super::support::{Building, Noise, drifting, laps, path};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{Correction, DropReason, PoseEstimate, PoseFlags, ScanId, SubmapClosed};
use flockslam_sync_manager::{FrozenScan, PlacedScan, Settings, Solution, SyncManager};
use std::f64::consts::FRAC_PI_2;

/// Replays a run; a submap is closed every 60 scans, and every second scan is inserted.
fn replay(
    building: &Building,
    truth: &[Pose],
    odom: &[Pose],
    settings: Settings,
) -> (Vec<Correction>, Solution) {
    replay_trajectories(building, truth, odom, |_| 0, settings)
}

/// The same, with scan i in trajectory `trajectory(i)` of submaps.
fn replay_trajectories(
    building: &Building,
    truth: &[Pose],
    odom: &[Pose],
    trajectory: impl Fn(usize) -> u32,
    settings: Settings,
) -> (Vec<Correction>, Solution) {
    replay_poses(building, truth, odom, |i, pose| pose.trajectory = trajectory(i), settings)
}

/// The same, with poses that `completed` gives the rest of what the front end says.
fn replay_poses(
    building: &Building,
    truth: &[Pose],
    odom: &[Pose],
    completed: impl Fn(usize, &mut PoseEstimate),
    settings: Settings,
) -> (Vec<Correction>, Solution) {
    let mut manager = SyncManager::new(settings);
    let mut noise = Noise(7);
    let mut headers = Vec::new();
    for (i, (at, odom)) in truth.iter().zip(odom).enumerate() {
        let id = ScanId { sequence: i as u64, ..ScanId::default() };
        let mut pose =
            PoseEstimate { id, odom_from_base: *odom, submap: i as u32 / 60, ..PoseEstimate::default() };
        pose.times.sensor_ns = i as i64 * 100_000_000;
        pose.flags = if i % 2 == 0 { PoseFlags::MATCHED | PoseFlags::INSERT } else { PoseFlags::MATCHED };
        completed(i, &mut pose);
        manager.pose(&pose);
        // One scan in seven never arrives with its points: its pose has to be filled in.
        if i % 7 != 3 {
            manager.node(building.scan(*at, &mut noise).view().unwrap(), &pose, &[]);
        }
        if i % 60 == 59 {
            headers.push(manager.submap_closed(&SubmapClosed {
                last: id,
                number: i as u32 / 60,
                ..SubmapClosed::default()
            }));
        }
    }
    (headers, manager.finish())
}

fn worst_error_m(solution: &Solution, truth: &[Pose]) -> f64 {
    let pairs = solution.trajectory.iter().zip(truth);
    pairs.map(|(placed, truth)| placed.map_from_base.distance_m(*truth)).fold(0.0, f64::max)
}

#[test]
fn a_drifting_front_end_is_straightened_by_its_loops() {
    let (building, truth) = (Building::ring(), laps(2));
    let odom = drifting(&truth, 0.004, 1.01);
    assert!(odom[odom.len() - 1].distance_m(truth[truth.len() - 1]) > 0.8, "the front end must need help");
    let (headers, solution) = replay(&building, &truth, &odom, Settings::default());
    assert_eq!(solution.trajectory.len(), truth.len());
    assert!(solution.trajectory.iter().enumerate().all(|(i, placed)| placed.id.sequence == i as u64));
    let first = solution.trajectory[0].map_from_base;
    assert!(
        first.distance_m(odom[0]) < 1e-9 && first.turn_rad(odom[0]) < 1e-9,
        "the first scan is the gauge"
    );
    let worst = worst_error_m(&solution, &truth);
    assert!(worst < 0.04, "{worst} {:?}", solution.closures);
    assert!(solution.closures.accepted > 10, "{:?}", solution.closures);
    let last = headers[headers.len() - 1];
    let corrected = last.map_from_odom * odom[headers.len() * 60 - 1];
    assert!(corrected.distance_m(truth[headers.len() * 60 - 1]) < 0.15, "{corrected:?}");
    assert!(headers.iter().enumerate().all(|(i, h)| h.revision == i as u32 + 1 && h.submap == i as u32));
    let all = truth.len().div_ceil(60) as u32;
    assert!(solution.submaps.iter().map(|placed| placed.number).eq(0..all), "all submaps are in the map");
    for placed in &solution.submaps {
        let middle = (placed.number as usize * 60 + 30).min(odom.len() - 1);
        assert!((placed.map_from_odom * odom[middle]).distance_m(truth[middle]) < 0.05, "{placed:?}");
    }
}

#[test]
fn dropped_scans_are_placed_by_their_own_points() {
    let (building, way) = (Building::ring(), laps(1));
    let odom = drifting(&way, 0.004, 1.01);
    // The robot sways, and odometry does not tell.
    let sways_rad = |i: usize| [0.0, 0.1, 0.0, -0.1][i % 4];
    let swaying = way.iter().enumerate().map(|(i, at)| *at * Pose::new(0.0, 0.0, sways_rad(i)));
    let truth: Vec<Pose> = swaying.collect();
    let dropped = |i: usize, pose: &mut PoseEstimate| {
        if i % 2 == 1 {
            (pose.flags, pose.drop_reason) = (0, DropReason::Correlated as u32);
        }
    };
    let (_, solution) = replay_poses(&building, &truth, &odom, dropped, Settings::default());
    // The dropped scans whose points have arrived, and those without.
    let errors_rad = |has_points: bool| {
        let placed = solution.trajectory.iter().zip(&truth).enumerate();
        let asked = placed.filter(|(i, _)| i % 2 == 1 && (i % 7 != 3) == has_points);
        let mut errors: Vec<f64> =
            asked.map(|(_, (placed, at))| placed.map_from_base.turn_rad(*at)).collect();
        errors.sort_by(f64::total_cmp);
        (errors[errors.len() / 2], errors[errors.len() * 98 / 100])
    };
    let (median_rad, almost_all_rad) = errors_rad(true);
    assert!(median_rad < 0.002 && almost_all_rad < 0.02, "{median_rad} {almost_all_rad}");
    assert!(errors_rad(false).0 > 0.05, "without points nothing says that the robot sways");
}

/// The front end inserts nothing while the robot stands at the start of a drive.
#[test]
fn scans_before_the_first_node_are_placed_by_their_own_points() {
    let (building, mut truth) = (Building::ring(), laps(1));
    truth.splice(0..0, [truth[0]; 20]);
    // It has the robot beside the place where it stands.
    let beside = |i: usize| if i < 20 { Pose::new(0.0, 0.04, 0.01) } else { Pose::IDENTITY };
    let odom: Vec<Pose> = truth.iter().enumerate().map(|(i, at)| *at * beside(i)).collect();
    let inserted = |i: usize, pose: &mut PoseEstimate| {
        if i < 20 {
            pose.flags = if i == 0 { PoseFlags::INSERT } else { PoseFlags::MATCHED };
        }
    };
    let (_, solution) = replay_poses(&building, &truth, &odom, inserted, Settings::default());
    let poses: Vec<Pose> = solution.trajectory.iter().map(|placed| placed.map_from_base).collect();
    for i in 0..20 {
        let off = poses[40].to(poses[i]);
        let expected = truth[40].to(truth[i]);
        assert!(
            off.distance_m(expected) < 0.008 && off.turn_rad(expected) < 0.003,
            "{i}: {off:?} {expected:?}"
        );
    }
}

#[test]
fn a_kidnapped_robot_is_attached_to_its_own_earlier_trajectory() {
    let (building, truth) = (Building::ring(), laps(2));
    let carried = truth.len() / 2 + 40;
    let elsewhere = Pose::new(30.0, -20.0, 2.2);
    let odom: Vec<Pose> =
        truth.iter().enumerate().map(|(i, at)| if i < carried { *at } else { elsewhere * *at }).collect();
    let trajectory = |i: usize| u32::from(i >= carried);
    let (headers, solution) = replay_trajectories(&building, &truth, &odom, trajectory, Settings::default());
    assert_eq!((solution.closures.trajectories, solution.closures.detached_scans), (2, 0));
    let worst = worst_error_m(&solution, &truth);
    assert!(worst < 0.05, "{worst} {:?}", solution.closures);
    let last = headers[headers.len() - 1];
    assert_eq!((last.trajectory, last.attached), (1, 1), "found while driving");
    assert!((last.map_from_odom * elsewhere).distance_m(Pose::IDENTITY) < 0.3, "{last:?}");
    assert!(headers.iter().any(|header| (header.trajectory, header.attached) == (1, 0)));
    let all = headers.len() as u32;
    assert!(solution.submaps.iter().map(|placed| placed.number).eq(0..=all), "all submaps are in the map");
}

#[test]
fn a_short_drive_after_the_robot_was_carried_is_found_as_a_whole() {
    let (building, laps) = (Building::ring(), laps(2));
    let carried = laps.len() / 2 + 40;
    let truth = &laps[..carried + 70];
    let elsewhere = Pose::new(30.0, -20.0, 2.2);
    let odom: Vec<Pose> =
        truth.iter().enumerate().map(|(i, at)| if i < carried { *at } else { elsewhere * *at }).collect();
    let trajectory = |i: usize| u32::from(i >= carried);
    let (headers, solution) = replay_trajectories(&building, truth, &odom, trajectory, Settings::default());
    assert!(headers.iter().all(|header| (header.trajectory, header.attached) != (1, 1)), "not while driving");
    assert_eq!((solution.closures.trajectories, solution.closures.detached_scans), (2, 0));
    let worst_m = worst_error_m(&solution, truth);
    assert!(worst_m < 0.05, "{worst_m} {:?}", solution.closures);
}

/// In the second half of a drive the robot is lost and continues at its odometry pose; its true pose is `off` from there.
fn lost_and_followed(odom: &[Pose], lost: usize) -> impl Fn(usize, &mut PoseEstimate) {
    let odom = odom.to_vec();
    move |i, pose| {
        (pose.odometry, pose.trajectory) = (odom[i], u32::from(i >= lost));
        pose.flags |= PoseFlags::HAS_ODOMETRY | if i == lost { PoseFlags::CONTINUES } else { 0 };
    }
}

#[test]
fn a_lost_robot_stays_in_the_map_at_its_odometry_pose() {
    // A lap is too short for a closure: odometry alone connects its halves.
    let (building, truth) = (Building::ring(), laps(1));
    let lost = truth.len() / 2;
    let odom = drifting(&truth, 0.002, 1.005);
    let (headers, solution) =
        replay_poses(&building, &truth, &odom, lost_and_followed(&odom, lost), Settings::default());
    assert_eq!((solution.closures.trajectories, solution.closures.detached_scans), (2, 0));
    assert!(headers.iter().all(|header| header.attached == 1), "it is never said to be apart");
    let worst_m = worst_error_m(&solution, &truth);
    assert!(worst_m < 0.6, "{worst_m} {:?}", solution.closures);
}

#[test]
fn closures_rule_odometry_out_that_was_wrong_while_the_robot_was_lost() {
    let (building, truth) = (Building::ring(), laps(2));
    let lost = truth.len() / 2 + 40;
    let off = Pose::new(2.5, -1.5, 0.3);
    let odom: Vec<Pose> = truth
        .iter()
        .enumerate()
        .map(|(i, at)| if i < lost { *at } else { truth[lost] * off * truth[lost].to(*at) })
        .collect();
    let (_, solution) =
        replay_poses(&building, &truth, &odom, lost_and_followed(&odom, lost), Settings::default());
    assert_eq!((solution.closures.trajectories, solution.closures.detached_scans), (2, 0));
    let worst_m = worst_error_m(&solution, &truth);
    assert!(worst_m < 0.1, "{worst_m} {:?}", solution.closures);
}

#[test]
fn a_place_never_seen_before_stays_apart() {
    let (building, truth) = (Building::ring(), laps(1));
    let other = Building::endless();
    let mut odom = truth.clone();
    let far = path(&[(0.0, 0.0), (30.0, 0.0)]);
    let place = |at: &Pose| Pose::new(5.0, 5.0, 1.0) * *at;
    odom.extend(far.iter().map(place));
    let both = Building(
        building
            .0
            .iter()
            .copied()
            .chain(other.0.iter().map(|(a, b)| {
                let away = |p: &Point| Point::new(p.x_m + 500.0, p.y_m);
                (away(a), away(b))
            }))
            .collect(),
    );
    let mut all = truth.clone();
    all.extend(far.iter().map(|at| Pose::new(at.x_m + 500.0, at.y_m, at.heading_rad)));
    let begun = truth.len();
    let (_, solution) =
        replay_trajectories(&both, &all, &odom, |i| u32::from(i >= begun), Settings::default());
    assert_eq!((solution.closures.trajectories, solution.trajectory.len()), (2, all.len()));
    assert_eq!(solution.closures.detached_scans, far.len() as u64, "{:?}", solution.closures);
    let highest = solution.submaps.iter().map(|placed| placed.number).max();
    assert!(highest.is_some_and(|number| number as usize <= begun / 60), "its submaps are not in the map");
}

#[test]
fn well_constrained_nodes_freeze_and_memory_stays_bounded() {
    let (building, truth) = (Building::ring(), laps(12));
    let odom = drifting(&truth, 0.002, 1.005);
    let mut manager = SyncManager::new(Settings::default());
    let mut noise = Noise(7);
    let (mut frozen, mut held) = (Vec::new(), Vec::new());
    for (i, (at, odom)) in truth.iter().zip(&odom).enumerate() {
        let pose = inserted(i, *odom);
        manager.pose(&pose);
        manager.node(building.scan(*at, &mut noise).view().unwrap(), &pose, &[]);
        if i % 60 == 59 {
            let (last, number) = (pose.id, i as u32 / 60);
            manager.submap_closed(&SubmapClosed { last, number, ..SubmapClosed::default() });
            frozen.extend(manager.take_frozen());
            held.push(manager.held());
        }
    }
    let solution = manager.finish();
    assert!(frozen.len() > truth.len() / 3, "{} of {}", frozen.len(), truth.len());
    let (late, end) = (held[3 * held.len() / 4], held[held.len() - 1]);
    assert!(10 * end.0 < 11 * late.0 && 10 * end.1 < 11 * late.1 && 2 * end.2 < 3 * late.2, "{held:?}");
    let place = |scan: &FrozenScan| PlacedScan {
        id: scan.id,
        stamp_ns: scan.stamp_ns,
        map_from_base: solution.anchor(scan.anchor).unwrap() * scan.anchor_from_base,
    };
    let mut placed: Vec<_> = frozen.iter().map(place).collect();
    placed.extend(&solution.trajectory);
    placed.sort_by_key(|placed| placed.id.sequence);
    assert!(placed.iter().enumerate().all(|(i, placed)| placed.id.sequence == i as u64), "each scan once");
    let worst = placed
        .iter()
        .zip(&truth)
        .map(|(placed, at)| placed.map_from_base.distance_m(*at))
        .fold(0.0, f64::max);
    assert!(worst < 0.08, "{worst}");
    let all = truth.len().div_ceil(60) as u32;
    assert!(solution.submaps.iter().map(|placed| placed.number).eq(0..all));
    for placed in &solution.submaps {
        let middle = (placed.number as usize * 60 + 30).min(odom.len() - 1);
        assert!((placed.map_from_odom * odom[middle]).distance_m(truth[middle]) < 0.1, "{placed:?}");
    }
}

/// The published pose of scan i, which enters the map.
fn inserted(i: usize, odom_from_base: Pose) -> PoseEstimate {
    let id = ScanId { sequence: i as u64, ..ScanId::default() };
    let mut pose = PoseEstimate { id, odom_from_base, submap: i as u32 / 60, ..PoseEstimate::default() };
    pose.times.sensor_ns = i as i64 * 100_000_000;
    pose.flags = PoseFlags::MATCHED | PoseFlags::INSERT;
    pose
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let (building, truth) = (Building::ring(), laps(1));
    let odom = drifting(&truth, 0.004, 1.0);
    // As text, in which two numbers are the same only if their bits are: 0 and -0 are equal as numbers.
    let run = || format!("{:?}", replay(&building, &truth, &odom, Settings::default()));
    assert_eq!(run(), run());
}

#[test]
fn a_front_end_that_jumps_is_caught() {
    let (building, truth) = (Building::ring(), laps(2));
    let mut odom = drifting(&truth, 0.001, 1.0);
    for at in [150, 400] {
        let jump = Pose::new(0.5, -0.4, 0.6);
        let root = odom[at];
        let moved: Vec<Pose> = odom[at..].iter().map(|pose| root * jump * root.to(*pose)).collect();
        odom.splice(at.., moved);
    }
    let (_, solution) = replay(&building, &truth, &odom, Settings::default());
    let mut errors: Vec<f64> = solution
        .trajectory
        .iter()
        .zip(&truth)
        .map(|(placed, truth)| placed.map_from_base.distance_m(*truth))
        .collect();
    errors.sort_by(f64::total_cmp);
    // The scan or two at a jump may be anywhere between its ends.
    let most = errors[errors.len() - 1 - errors.len() / 50];
    assert!(most < 0.04, "{most} {:?}", solution.closures);
}

#[test]
fn a_corridor_that_repeats_itself_closes_no_false_loop() {
    let building = Building::endless();
    let truth = path(&[(0.0, 0.0), (72.0, 0.0), (2.0, 0.0), (40.0, 0.0)]);
    let odom = drifting(&truth, 0.0, 1.02);
    let (_, with) = replay(&building, &truth, &odom, Settings::default());
    let (_, without) =
        replay(&building, &truth, &odom, Settings { close_loops: false, ..Settings::default() });
    let (with_m, without_m) = (worst_error_m(&with, &truth), worst_error_m(&without, &truth));
    // A false loop is metres off; without any false one, both are off by centimetres.
    assert!(with_m < 0.15, "{with_m} m against {without_m} m, {:?}", with.closures);
}

#[test]
fn scans_without_points_and_an_empty_run_do_no_harm() {
    let mut manager = SyncManager::new(Settings::default());
    assert_eq!(manager.submap_closed(&SubmapClosed::default()).map_from_odom, Pose::IDENTITY);
    let (nothing, truth) = (Building::new(), laps(1));
    let odom = drifting(&truth, FRAC_PI_2 / 200.0, 1.0);
    let (_, solution) = replay(&nothing, &truth, &odom, Settings::default());
    assert!(worst_error_m(&solution, &odom) < 1e-6, "without points the front end's path stands");
    assert_eq!(SyncManager::new(Settings::default()).finish(), Solution::default());
}

#[test]
fn a_chain_that_runs_back_counts_as_the_newest() {
    let (ring, mut manager, mut noise) = (Building::ring(), SyncManager::new(Settings::default()), Noise(7));
    let mut pose = PoseEstimate { flags: PoseFlags::MATCHED | PoseFlags::INSERT, ..PoseEstimate::default() };
    for (k, trajectory) in [0, 0, 1, 1, 0, 0].into_iter().enumerate() {
        pose.id.sequence = k as u64;
        pose.trajectory = trajectory;
        pose.odom_from_base = Pose::new(0.3 * k as f64, 0.0, 0.0);
        manager.pose(&pose);
        manager.node(ring.scan(pose.odom_from_base, &mut noise).view().unwrap(), &pose, &[]);
        assert_eq!(
            manager.submap_closed(&SubmapClosed { last: pose.id, ..SubmapClosed::default() }).trajectory,
            [0, 0, 1, 1, 1, 1][k]
        );
    }
    assert_eq!(manager.finish().trajectory.len(), 6);
}
