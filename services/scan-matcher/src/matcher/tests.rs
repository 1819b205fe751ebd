//! Tests of matcher and mapper together, in a simulated room.

use super::*;
use crate::settings::Strategy;
use flockslam_geometry::wrap_angle;
use flockslam_mapper::Mapper;
use flockslam_messages::{DropReason, FlockRobot, STARTS_DETACHED, ScanBuffer};

/// A room of 8 × 6 m with a pillar, seen from `pose`; odometry is what the robot claims.
pub(super) fn look(sequence: u64, pose: Pose, odometry: Option<Pose>) -> ScanBuffer {
    let walls = [(1.0, 0.0, 5.02), (1.0, 0.0, -3.04), (0.0, 1.0, 2.53), (0.0, 1.0, -3.48)];
    let range = |i: u32| {
        let angle = pose.heading_rad - 3.0 + 0.02 * f64::from(i);
        let (sin, cos) = angle.sin_cos();
        let to_wall = |(nx, ny, offset): (f64, f64, f64)| {
            let range = (offset - nx * pose.x_m - ny * pose.y_m) / (nx * cos + ny * sin);
            if range > 0.0 { range } else { f64::INFINITY }
        };
        let (px, py) = (2.7 - pose.x_m, 1.2 - pose.y_m);
        let along = px * cos + py * sin;
        let inside = 0.09 - (px * sin - py * cos).powi(2);
        let pillar = if along > 0.0 && inside > 0.0 { along - inside.sqrt() } else { f64::INFINITY };
        walls.into_iter().map(to_wall).fold(pillar, f64::min) as f32
    };
    let mut scan = ScanBuffer::from_ranges(&(0..300).map(range).collect::<Vec<_>>(), -3.0, 0.02);
    scan.header.range_max_m = 40.0;
    scan.header.id.sequence = sequence;
    scan.header.times.sensor_ns = 100_000_000 * sequence as i64;
    scan.header.odometry = odometry.unwrap_or_default();
    scan.header.has_odometry = u32::from(odometry.is_some());
    scan
}

pub(super) struct FrontEnd {
    pub(super) matcher: ScanMatcher,
    mapper: Mapper,
    pub(super) grid: TileGrid<Box<Tile>>,
}

impl FrontEnd {
    pub(super) fn new(settings: Settings) -> Self {
        let mapper = flockslam_mapper::Settings::default();
        let grid = TileGrid::new(mapper.cell_size_m);
        Self { matcher: ScanMatcher::new(settings), mapper: Mapper::new(mapper), grid }
    }

    /// Its matcher is another process from here on, which knows what its predecessor has published.
    pub(super) fn start_again(&mut self, published: &[PoseEstimate]) {
        let MapState { generation, active_submap, .. } = self.matcher.map;
        self.matcher = ScanMatcher::new(self.matcher.settings.clone());
        published.iter().for_each(|pose| self.matcher.restore(pose));
        published.iter().last().iter().for_each(|last| self.matcher.resume(last));
        self.matcher.committed(&Commit { generation, active_submap, ..Commit::default() });
    }

    /// As [`FrontEnd::step`], of a scan that is handled before the grid has arrived.
    pub(super) fn step_without_grid(&mut self, scan: &ScanBuffer) -> PoseEstimate {
        let nothing = TileGrid::new(self.grid.cell_size_m());
        let there = std::mem::replace(&mut self.grid, nothing);
        let estimate = self.step(scan, true);
        self.grid = there;
        estimate
    }

    pub(super) fn step(&mut self, scan: &ScanBuffer, keep: bool) -> PoseEstimate {
        let view = scan.view().unwrap();
        let reason = if keep { 0 } else { DropReason::Correlated as u32 };
        let verdict = Verdict { id: scan.header.id, keep: u32::from(keep), reason, ..Verdict::default() };
        let estimate = self.matcher.handle(view, &verdict, &self.grid);
        if estimate.has(PoseFlags::INSERT) {
            let insertion = self.mapper.insert(view, &estimate, &[]);
            let (generation, active_submap) = (insertion.generation, insertion.active_submap);
            insertion.retired.iter().for_each(|key| drop(self.grid.remove(*key)));
            let changed = insertion.changed.to_vec();
            for key in changed {
                let mut tile = Tile::unknown(0);
                self.mapper.write_tile(key, &mut tile);
                self.grid.set(key, tile).unwrap();
            }
            self.matcher.committed(&Commit { generation, active_submap, ..Commit::default() });
        }
        estimate
    }
}

/// A curved drive through the room.
pub(super) fn truth(i: u64) -> Pose {
    let t = i as f64;
    Pose::new(0.04 * t, 0.3 * (0.05 * t).sin(), 0.02 * t)
}

/// Wheels that turn too much and slip.
fn odometry(i: u64) -> Pose {
    let turn = Pose::new(0.0, 0.0, 1.3);
    (1..=i).fold(turn, |pose, k| {
        let step = truth(k - 1).to(truth(k));
        pose * Pose::new(0.9 * step.x_m, step.y_m, wrap_angle(step.heading_rad + 0.006))
    })
}

/// Where the robot is in `odom`, which begins where it starts.
fn in_odom(i: u64) -> Pose {
    truth(0).to(truth(i))
}

#[test]
fn follows_the_robot_with_wheels_that_slip_and_turn_too_much() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..80 {
        let estimate = front_end.step(&look(i, truth(i), Some(odometry(i))), true);
        let expected = in_odom(i);
        assert!(estimate.odom_from_base.distance_m(expected) < 0.03, "{i}: {estimate:?} for {expected:?}");
        assert!(estimate.odom_from_base.turn_rad(expected) < 0.01);
        assert_eq!(estimate.has(PoseFlags::MATCHED), i > 0);
        assert_eq!(estimate.quality, Quality::Tracking as u32);
    }
    let inserted = front_end.mapper.generation();
    assert!((15..30).contains(&inserted), "{inserted} of 80 scans entered the map");
}

/// Between the open and a car that is passed closely scores scatter, and where the car is out of sight a scan fits somewhere by chance.
#[test]
fn where_scores_scatter_a_scan_is_not_looked_for_in_a_wide_window() {
    let kick = Pose::new(0.5, -0.35, 0.33);
    let kicked = |score_variance: f64| {
        let mut front_end = FrontEnd::new(Settings::default());
        for i in 0..40 {
            front_end.step(&look(i, truth(i), Some(truth(i))), true);
        }
        front_end.matcher.confidence.score_variance = score_variance;
        front_end.step(&look(40, truth(40) * kick, Some(truth(40))), true).has(PoseFlags::RESCUED)
    };
    assert_eq!([0.001, 0.16].map(kicked), [true, false]);
}

/// Of a scan that fits nowhere, as behind a door, some points lie on something by chance.
#[test]
fn few_points_of_a_scan_that_fits_nowhere_are_no_sign_of_wheels_that_slip() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..60 {
        front_end.step(&look(i, truth(i), Some(truth(i))), true);
    }
    let turned = truth(60) * Pose::new(0.0, 0.0, 0.12);
    // Eighteen beams end where they would if the robot had not turned, all others outside of the room.
    let mut scan = look(60, truth(60), Some(turned));
    for (beam, range) in scan.numbers.iter_mut().enumerate() {
        if !(28..46).contains(&beam) {
            *range = if beam < 90 { 20.0 + 0.01 * beam as f32 } else { f32::INFINITY };
        }
    }
    let estimate = front_end.step(&scan, true);
    let expected = truth(0).to(turned);
    assert!(estimate.odom_from_base.turn_rad(expected) < 0.05, "{estimate:?} for {expected:?}");
}

#[test]
fn an_experiment_may_start_at_the_odometry_pose() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..40 {
        let mut scan = look(i, truth(i), Some(odometry(i)));
        scan.header.starts_at_odometry = 1;
        let estimate = front_end.step(&scan, true);
        assert!(estimate.odom_from_base.distance_m(odometry(0) * in_odom(i)) < 0.03, "{i}: {estimate:?}");
    }
}

#[test]
fn needs_no_odometry_and_no_sensible_stamps() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..80 {
        let mut scan = look(i, truth(i), None);
        if i % 7 == 3 {
            scan.header.times.sensor_ns -= 900_000_000;
        }
        let estimate = front_end.step(&scan, true);
        assert!(estimate.odom_from_base.distance_m(truth(i)) < 0.05, "{i}: {estimate:?}");
    }
}

#[test]
fn a_dropped_scan_gets_a_predicted_pose_and_touches_nothing() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..20 {
        let early = front_end.step(&look(i, truth(i), Some(truth(i))), i >= 10);
        assert_eq!(early.has(PoseFlags::OVERRIDDEN | PoseFlags::MATCHED), (1..10).contains(&i));
    }
    let generation = front_end.mapper.generation();
    let dropped = front_end.step(&look(20, truth(20), Some(truth(20))), false);
    assert!(dropped.odom_from_base.distance_m(truth(20)) < 0.02);
    assert_eq!((dropped.flags, dropped.score), (PoseFlags::HAS_ODOMETRY, 0.0));
    assert_eq!(dropped.drop_reason, DropReason::Correlated as u32);
    assert_eq!(front_end.mapper.generation(), generation);
    let overruled = (21..60).map(|i| front_end.step(&look(i, truth(i), Some(truth(i))), false));
    assert!(overruled.filter(|pose| pose.has(PoseFlags::OVERRIDDEN)).count() > 0, "drift is bounded");
}

#[test]
fn few_beams_turn_a_dropped_scan_where_odometry_is_off_but_no_withheld_one() {
    for (withheld, error_max_rad) in [(0, 0.005), (1, 0.11)] {
        let mut front_end = FrontEnd::new(Settings::default());
        for i in 0..40 {
            front_end.step(&look(i, truth(i), Some(truth(i))), true);
        }
        let generation = front_end.mapper.generation();
        let turned = truth(40) * Pose::new(0.0, 0.0, 0.1);
        let mut scan = look(40, truth(40), Some(turned));
        scan.header.withheld = withheld;
        let dropped = front_end.step(&scan, false);
        let error_rad = dropped.odom_from_base.turn_rad(truth(40));
        assert!(error_rad <= error_max_rad && error_rad > error_max_rad - 0.02, "{withheld}: {error_rad}");
        assert!(dropped.odom_from_base.distance_m(truth(40)) < 0.02);
        assert_eq!((dropped.flags, dropped.score), (PoseFlags::HAS_ODOMETRY, 0.0));
        assert_eq!(front_end.mapper.generation(), generation);
    }
}

#[test]
fn a_withheld_scan_is_never_matched() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..20 {
        let mut scan = look(i, truth(i), Some(truth(i)));
        scan.header.withheld = u32::from(i == 0 || i > 15);
        let estimate = front_end.step(&scan, i % 2 == 1);
        if scan.header.withheld == 1 {
            assert_eq!((estimate.flags, estimate.score), (PoseFlags::HAS_ODOMETRY, 0.0), "{i}");
        }
    }
    assert!(front_end.mapper.generation() > 0, "there was a map to match them with");
}

#[test]
fn odometry_that_jumps_is_seen_through_a_kick_is_rescued_and_nonsense_never_enters_the_map() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..28 {
        front_end.step(&look(i, truth(i), Some(truth(i))), true);
    }
    let slip = Pose::new(0.8, -0.5, 1.5);
    let estimate = front_end.step(&look(28, truth(28), Some(truth(28) * slip)), true);
    assert!(estimate.odom_from_base.distance_m(truth(28)) < 0.03, "{estimate:?}");
    assert!(estimate.twist.turn_rad_s.abs() < 1.0, "the wheels' jump is no motion");
    front_end.step(&look(29, truth(29), Some(truth(29) * slip)), true);

    let kick = Pose::new(0.5, -0.35, 0.33);
    let estimate = front_end.step(&look(30, truth(30) * kick, Some(truth(30) * slip)), true);
    assert!(estimate.odom_from_base.distance_m(truth(30) * kick) < 0.03, "{estimate:?}");
    assert!(estimate.has(PoseFlags::RESCUED));
    let estimate = front_end.step(&look(31, truth(31), Some(truth(31) * slip)), true);
    assert!(estimate.odom_from_base.distance_m(truth(31)) < 0.03, "{estimate:?}");

    let mut noise = look(31, truth(31), Some(truth(31) * slip));
    noise.numbers.iter_mut().enumerate().for_each(|(i, range)| *range = 0.5 + (i * 7919 % 97) as f32 * 0.01);
    let lost = front_end.step(&noise, true);
    assert_eq!((lost.quality, lost.has(PoseFlags::INSERT)), (Quality::Lost as u32, false));
    let found = front_end.step(&look(32, truth(32), Some(truth(32) * slip)), true);
    assert!(found.odom_from_base.distance_m(truth(32)) < 0.03 && found.quality == Quality::Tracking as u32);
}

#[test]
fn a_robot_that_stays_lost_begins_a_new_chain_and_leaves_the_map_alone() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..30 {
        front_end.step(&look(i, truth(i), Some(truth(i))), true);
    }
    let generation = front_end.mapper.generation();
    // Carried to the other end of the room, while odometry notices nothing.
    let carried = |i: u64| Pose::new(4.3, -1.0, 2.5) * truth(i);
    let mut lost = 0;
    let mut estimates = (30..).map(|i| front_end.step(&look(i, carried(i), Some(truth(i))), true));
    let begun = estimates.by_ref().take(40).find(|estimate| {
        lost += u32::from(estimate.quality == Quality::Lost as u32);
        estimate.trajectory == 1
    });
    let begun = begun.expect("a new chain");
    drop(estimates);
    assert!(lost >= 5 && begun.has(PoseFlags::INSERT) && !begun.has(PoseFlags::MATCHED), "{lost} {begun:?}");
    assert_eq!(begun.quality, Quality::Degraded as u32);
    assert_eq!(front_end.mapper.generation(), generation + 1, "nothing was inserted while lost");
    let first = begun.id.sequence;
    for i in first + 1..first + 30 {
        let estimate = front_end.step(&look(i, carried(i), Some(truth(i))), true);
        let moved = carried(first).to(carried(i));
        let seen = begun.odom_from_base.to(estimate.odom_from_base);
        assert!(seen.distance_m(moved) < 0.05, "{i} {estimate:?}");
        assert_eq!(
            (estimate.trajectory, estimate.quality),
            (1, Quality::Degraded as u32),
            "its place is a guess"
        );
    }
    let attached = Correction { trajectory: 1, attached: 1, ..Correction::default() };
    front_end.matcher.corrected(&attached);
    let i = first + 30;
    let estimate = front_end.step(&look(i, carried(i), Some(truth(i))), true);
    assert_eq!(estimate.quality, Quality::Tracking as u32);
}

#[test]
fn inserts_nothing_after_a_restart_until_the_grid_is_there() {
    let mut front_end = FrontEnd::new(Settings::default());
    let last = (0..30).map(|i| front_end.step(&look(i, truth(i), Some(odometry(i))), true)).last().unwrap();
    let nothing = TileGrid::new(front_end.grid.cell_size_m());
    let there = std::mem::replace(&mut front_end.grid, nothing);
    front_end.matcher = ScanMatcher::new(Settings::default());
    front_end.matcher.resume(&last);
    let blind = front_end.step(&look(30, truth(30), Some(odometry(30))), true);
    assert!(!blind.has(PoseFlags::INSERT) && blind.quality == Quality::Degraded as u32, "{blind:?}");
    front_end.grid = there;
    assert!(front_end.step(&look(31, truth(31), Some(odometry(31))), true).has(PoseFlags::MATCHED));
}

#[test]
fn continues_where_its_predecessor_stopped() {
    let mut front_end = FrontEnd::new(Settings::default());
    let last = (0..30).map(|i| front_end.step(&look(i, truth(i), Some(odometry(i))), true)).last().unwrap();
    front_end.matcher.corrected(&Correction { revision: 2, ..Correction::default() });
    front_end.matcher = ScanMatcher::new(Settings::default());
    front_end.matcher.resume(&last);
    let estimate = front_end.step(&look(30, truth(30), Some(odometry(30))), true);
    assert!(estimate.odom_from_base.distance_m(in_odom(30)) < 0.03 && estimate.has(PoseFlags::MATCHED));
    assert_eq!((estimate.generation, estimate.submap), (last.generation, last.submap));
}

#[test]
fn all_strategies_follow_and_repeat_themselves() {
    for strategy in [
        Strategy::GaussNewton,
        Strategy::MonteCarlo,
        Strategy::HillClimbing,
        Strategy::Correlative,
        Strategy::Ndt,
    ] {
        let settings = Settings { strategy, ..Settings::default() };
        let mut pair = [FrontEnd::new(settings.clone()), FrontEnd::new(settings)];
        for i in 0..30 {
            let scan = look(i, truth(i), Some(truth(i)));
            let poses = pair.each_mut().map(|front_end| front_end.step(&scan, true));
            assert_eq!(poses[0], poses[1]);
            assert!(poses[0].odom_from_base.distance_m(truth(i)) < 0.15, "{strategy:?} {i}");
        }
    }
}

#[test]
fn scans_of_any_size_are_taken() {
    let mut front_end = FrontEnd::new(Settings::default());
    for (sequence, beams) in [0usize, 1, 4, 1_000_000].into_iter().enumerate() {
        let mut scan = ScanBuffer::from_ranges(&vec![3.0; beams], -3.0, 6.0 / beams.max(1) as f64);
        scan.header.id.sequence = sequence as u64;
        let estimate = front_end.step(&scan, true);
        assert_eq!(estimate.has(PoseFlags::INSERT), beams > 4, "{beams}");
    }
}

#[test]
fn scans_that_take_time_and_end_outside_the_map_are_fitted_by_every_strategy() {
    let strategies = [
        Strategy::GaussNewton,
        Strategy::MonteCarlo,
        Strategy::HillClimbing,
        Strategy::Correlative,
        Strategy::Ndt,
    ];
    for strategy in strategies {
        let mut front_end = FrontEnd::new(Settings { strategy, ..Settings::default() });
        for sequence in 0..3 {
            let pose = Pose::new(0.05 * sequence as f64, 0.0, 0.0);
            let mut scan = look(sequence, pose, Some(pose));
            scan.header.time_increment_s = 1e-5;
            if sequence == 0 {
                // Of the room only what is near is mapped.
                scan.numbers.iter_mut().filter(|range| **range > 3.0).for_each(|range| *range = f32::NAN);
            }
            let estimate = front_end.step(&scan, true);
            assert!(estimate.odom_from_base.distance_m(pose) < 0.2, "{strategy:?}: {estimate:?}");
            assert_eq!(estimate.has(PoseFlags::MATCHED), sequence > 0, "{strategy:?}: {estimate:?}");
        }
    }
}

#[test]
fn a_continued_map_begins_a_chain_of_its_own_wherever_the_robot_is_by_now() {
    let mut before = FrontEnd::new(Settings::default());
    let last = (0..40).map(|i| before.step(&look(i, truth(i), Some(odometry(i))), true)).last().unwrap();
    let mut after = FrontEnd { matcher: ScanMatcher::new(Settings::default()), ..before };
    after.matcher.resume_detached(&last);
    // Carried to the start of the drive and turned; odometry counts from somewhere else.
    let carried = |i: u64| Pose::new(-1.0, -1.0, 2.0) * truth(i);
    for i in 0..30 {
        let estimate = after.step(&look(40 + i, carried(i), Some(truth(i))), true);
        assert_eq!((estimate.trajectory, estimate.has(PoseFlags::MATCHED)), (last.trajectory + 1, i > 0));
        assert_eq!(estimate.quality, Quality::Degraded as u32, "nothing connects it with the map yet");
        let moved = last.odom_from_base.to(estimate.odom_from_base);
        let expected = carried(0).to(carried(i));
        assert!(moved.distance_m(expected) < 0.05, "{i}: {moved:?} for {expected:?}");
    }
}

#[test]
fn a_scan_that_nothing_connects_with_the_one_before_begins_a_trajectory_of_its_own() {
    let mut front_end = FrontEnd::new(Settings::default());
    let last = (0..40).map(|i| front_end.step(&look(i, truth(i), Some(odometry(i))), true)).last().unwrap();
    // A simulation begins anew: the robot stands where it began, and so do its wheels and its clock.
    for i in 0..30 {
        let mut scan = look(i, truth(i), Some(odometry(i)));
        scan.header.id.sequence = 40 + i;
        scan.header.starts_at_odometry = if i == 0 { STARTS_DETACHED } else { 0 };
        let estimate = front_end.step(&scan, true);
        assert_eq!(
            (estimate.trajectory, estimate.has(PoseFlags::MATCHED)),
            (last.trajectory + 1, i > 0),
            "{i}"
        );
        assert_eq!(estimate.quality, Quality::Degraded as u32, "nothing connects it with the map yet");
        let moved = last.odom_from_base.to(estimate.odom_from_base);
        let expected = truth(0).to(truth(i));
        assert!(moved.distance_m(expected) < 0.05, "{i}: {moved:?} for {expected:?}");
    }
}

#[test]
fn without_a_grid_odometry_is_followed() {
    let mut matcher = ScanMatcher::new(Settings::default());
    for i in 0..20 {
        let estimate = matcher.follow_odometry(look(i, truth(i), Some(odometry(i))).view().unwrap());
        let expected = odometry(0).to(odometry(i));
        assert!(estimate.odom_from_base.distance_m(expected) < 1e-9, "{i}: {estimate:?}");
        assert_eq!((estimate.quality, estimate.flags), (Quality::Degraded as u32, PoseFlags::HAS_ODOMETRY));
    }
}

/// A robot of the flock whose published pose is that of the pillar.
fn robot_at_the_pillar(received_ns: u64) -> FlockRobots {
    let mut robots = FlockRobots { count: 1, ..FlockRobots::default() };
    robots.robots[0] = FlockRobot {
        map_from_base: Pose::new(2.7, 1.2, 0.0) * Pose::new(0.0, 0.0, 1.0),
        received_ns,
        radius_m: 0.35,
        name: *b"other\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
    };
    robots
}

#[test]
fn another_robot_that_stands_at_a_wall_is_set_aside_where_it_says_that_it_is() {
    let mut front_end = FrontEnd::new(Settings::default());
    let received_ns = 5_000_000_000;
    let see = |front_end: &mut FrontEnd, i: u64, now_ns: u64| {
        let mut scan = look(i, truth(i), Some(truth(i)));
        scan.header.times.monotonic_ns = now_ns;
        front_end.step(&scan, true);
        front_end.matcher.moving_beams().to_vec()
    };
    (0..40).for_each(|i| assert_eq!(see(&mut front_end, i, received_ns), []));
    let there = truth(40);
    front_end.matcher.set_flock_robots(&robot_at_the_pillar(received_ns));
    let [seen] = see(&mut front_end, 40, received_ns + 100_000_000)[..] else { panic!("one range") };
    let bearing = (1.2 - there.y_m).atan2(2.7 - there.x_m) - there.heading_rad;
    let middle = ((bearing + 3.0) / 0.02).round() as u32;
    assert!(seen.first < middle && middle < seen.end && seen.end - seen.first < 30, "{seen:?} {middle}");
    // Its last message is too old.
    assert_eq!(see(&mut front_end, 41, received_ns + 3_000_000_000), []);
}

#[test]
fn movers_that_are_not_confirmed_take_nothing_from_the_robot_beside_them() {
    let mut front_end = FrontEnd::new(Settings::default());
    for i in 0..40 {
        front_end.step(&look(i, truth(i), Some(truth(i))), true);
    }
    front_end.matcher.set_flock_robots(&robot_at_the_pillar(0));
    front_end.step(&look(40, truth(40), Some(truth(40))), true);
    let [robot] = front_end.matcher.moving_beams()[..] else { panic!("one range") };
    // Something as wide as a wall, directly beside it.
    let beside = robot.end as usize..robot.end as usize + 100;
    front_end.step(&hidden(look(41, truth(40), Some(truth(40))), beside, 1.0), true);
    assert_eq!(front_end.matcher.moving_beams(), [robot]);
}

/// The same scan with whatever is nearer in `directions`, beams.
fn hidden(mut scan: ScanBuffer, directions: std::ops::Range<usize>, range_m: f32) -> ScanBuffer {
    scan.numbers[directions].iter_mut().for_each(|range| *range = range.min(range_m));
    scan
}

#[test]
fn a_person_in_free_space_is_left_out_and_a_wall_is_not() {
    let mut front_end = FrontEnd::new(Settings::default());
    let mut see = |i: u64, change: &dyn Fn(ScanBuffer) -> ScanBuffer| {
        front_end.step(&change(look(i, truth(i), Some(truth(i)))), true);
        front_end.matcher.moving_beams().to_vec()
    };
    for i in 0..40 {
        assert_eq!(see(i, &|scan| scan), [], "nothing moves at scan {i}");
    }
    let somebody = see(40, &|scan| hidden(scan, 20..32, 1.5));
    assert_eq!(somebody, [BeamRange { first: 20, end: 32 }]);
    // As wide as half of a wall: the robot is not where the prediction has it.
    assert_eq!(see(41, &|scan| hidden(scan, 20..80, 1.8)), []);
}
