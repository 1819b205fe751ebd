//! Tests of simulated drives: their ways, scans, wheels, errors and worlds.

use super::drive::{SPEED_M_S, TURN_RAD_S};
use super::*;
use flockslam_geometry::{Point, Twist};
use flockslam_messages::ScanView;

fn short() -> Settings {
    Settings { duration_s: 30.0, ..Settings::default() }
}

/// A lidar and wheels without errors.
fn no_errors() -> Errors {
    Errors { odometry_scale_error: 0.0, odometry_walk: [0.0; 2], ..Errors::without_lidar() }
}

fn run(settings: &Settings) -> Vec<(ScanBuffer, Pose)> {
    run_with(settings, &settings.errors())
}

fn run_with(settings: &Settings, errors: &Errors) -> Vec<(ScanBuffer, Pose)> {
    Simulation::with_errors(settings, World::built_in(settings), errors).unwrap().collect()
}

/// With a lidar and odometry without noise, and no slips but the configured ones.
fn run_ideal(settings: Settings, wheel_slips: u32) -> Vec<(ScanBuffer, Pose)> {
    run_with(&Settings { wheel_slips, ..settings }, &no_errors())
}

/// Bounded motion, clear of walls, past every way point, and at the end back near the start.
#[test]
fn the_demo_drives_through_the_whole_building() {
    let settings = Settings::default();
    let scans = run(&settings);
    assert_eq!(scans.len(), 2500);
    let World::FloorPlan(plan) = World::floor_plan() else { unreachable!() };
    let nearest_m =
        scans.iter().map(|(_, truth)| plan.distance_m(truth.position())).fold(f64::INFINITY, f64::min);
    let driven_m: f64 = scans.windows(2).map(|pair| pair[0].1.distance_m(pair[1].1)).sum();
    assert!(nearest_m > 0.25 && driven_m > 120.0, "{driven_m:.0} m driven, nearest wall {nearest_m:.2} m");
    for pair in scans.windows(2) {
        let twist = Twist::from_motion(pair[0].1.to(pair[1].1), 0.1);
        assert!(twist.x_m_s < SPEED_M_S + 1e-6 && twist.turn_rad_s.abs() < TURN_RAD_S + 1e-6);
        assert!(twist.y_m_s.abs() < 0.05);
    }
    for (i, point) in plan.way_points().iter().enumerate() {
        let visited = scans.iter().any(|(_, truth)| truth.position().distance_m(*point) < 0.6);
        assert!(visited, "way point {i} is not visited");
    }
    let (first, last) = (&scans[0].1, &scans[scans.len() - 200..]);
    assert!(last.iter().any(|(_, truth)| truth.distance_m(*first) < 3.0), "the drive does not come back");
}

/// Every other world has a round that is clear of walls, passes all its way points, and comes back to places seen before
/// – at the latest when it begins anew.
#[test]
fn the_worlds_have_rounds_that_close() {
    for (world, round_s) in
        [(WorldName::Hotel, 760.0), (WorldName::Warehouse, 1100.0), (WorldName::Yard, 500.0)]
    {
        let settings = Settings { world, duration_s: round_s, beams: 8, ..Settings::default() };
        let truth: Vec<Pose> = run(&settings).iter().map(|(_, truth)| *truth).collect();
        let World::FloorPlan(plan) = World::built_in(&settings) else { unreachable!() };
        let nearest_m =
            truth.iter().step_by(7).map(|at| plan.distance_m(at.position())).fold(f64::INFINITY, f64::min);
        let passed = |point: &Point| truth.iter().any(|at| at.position().distance_m(*point) < 0.6);
        let missed: Vec<_> = plan.way_points().iter().filter(|point| !passed(point)).collect();
        let back = truth[truth.len() / 2..].iter().any(|at| at.distance_m(truth[0]) < 1.0);
        assert!(
            nearest_m > 0.25 && missed.is_empty() && back,
            "{world:?}: {nearest_m} m, {missed:?}, {back}"
        );
    }
}

/// Odometry does not show a kidnapping; only the ground truth jumps, and the scans with it.
#[test]
fn a_kidnap_moves_the_truth_only() {
    let free = Settings { duration_s: 60.0, ..Settings::default() };
    let carried = Settings { kidnap_at_s: vec![40.0, 20.0], ..free.clone() };
    let (free, carried) = (run_ideal(free, 0), run_ideal(carried, 0));
    assert_eq!(free[..200], carried[..200]);
    let World::FloorPlan(plan) = World::floor_plan() else { unreachable!() };
    for (i, pair) in carried.windows(2).enumerate() {
        let (moved_m, turned) = (pair[0].1.distance_m(pair[1].1), pair[0].1.turn_rad(pair[1].1));
        let (before, after) = (pair[0].0.header.odometry, pair[1].0.header.odometry);
        assert!(before.distance_m(after) < 0.1 && before.turn_rad(after) < 0.11, "scan {}", i + 1);
        match i + 1 {
            200 | 400 => assert!(moved_m > 5.0 && plan.distance_m(pair[1].1.position()) > 0.25),
            _ => assert!(moved_m < 0.1 && turned < 0.11, "scan {}: {moved_m} m", i + 1),
        }
    }
    // It goes on driving from there.
    assert!(carried[400].1.distance_m(carried[599].1) > 1.0);
    let wrong = Settings { kidnap_at_s: vec![1.0; 101], ..Settings::default() };
    assert!(Simulation::new(&wrong, World::floor_plan()).is_err());
}

/// A patrol of eight hours does not come to an end before its time, and the robot keeps driving.
#[test]
fn a_patrol_goes_on_for_hours() {
    let settings = Settings { duration_s: 28_800.0, scan_rate_hz: 1.0, beams: 1, ..Settings::default() };
    let mut drive = Simulation::new(&settings, World::floor_plan()).unwrap();
    assert_eq!(drive.scans(), 28_800);
    let (mut scan, mut driven_m, mut last) = (ScanBuffer::default(), 0.0, None::<Pose>);
    while let Some(truth) = drive.next_scan(&mut scan) {
        driven_m += last.map_or(0.0, |last| last.distance_m(truth));
        last = Some(truth);
    }
    assert_eq!(scan.header.id.sequence, 28_799);
    assert!(driven_m > 15_000.0, "{driven_m} m");
}

/// Each beam of an ideal lidar ends on a wall, seen from where the robot is at that beam's time.
#[test]
fn ranges_belong_to_the_moving_pose() {
    let scans = run_ideal(short(), 0);
    let World::FloorPlan(plan) = World::floor_plan() else { unreachable!() };
    let (mut skewed, mut flat) = (0.0f64, 0.0f64);
    for pair in scans.windows(2) {
        let ((scan, truth), (_, after)) = (&pair[0], &pair[1]);
        let view = scan.view().unwrap();
        let twist = Twist::from_motion(truth.to(*after), 0.1);
        for beam in (0..view.len()).step_by(17) {
            let Some(range_m) = view.valid_range_m(beam) else { continue };
            let base = *truth * twist.motion_after(view.time_s(beam));
            skewed = skewed.max(plan.distance_m(end_point(&view, base, beam, range_m)));
            flat = flat.max(plan.distance_m(end_point(&view, *truth, beam, range_m)));
        }
    }
    // The mean twist of a scan is not quite that of each of its beams, hence not exactly zero.
    assert!(skewed < 0.06, "{skewed}");
    assert!(flat > 0.2, "{flat}");
}

fn end_point(view: &ScanView<'_>, base: Pose, beam: usize, range_m: f64) -> Point {
    let (sin, cos) = view.angle_rad(beam).sin_cos();
    (base * view.header().base_from_laser).apply(Point::new(range_m * cos, range_m * sin))
}

#[test]
fn ideal_wheels_give_the_truth_and_real_ones_do_not() {
    let scans = run_ideal(short(), 0);
    let start = scans[0].1;
    assert!(scans.iter().all(|(scan, truth)| (start * scan.header.odometry).distance_m(*truth) < 1e-6));
    let drifting = run(&Settings::default());
    let (last, truth) = drifting.last().unwrap();
    let drift_m = (drifting[0].1 * last.header.odometry).distance_m(*truth);
    assert!((0.5..60.0).contains(&drift_m), "{drift_m}");
}

#[test]
fn a_slip_turns_odometry_only() {
    let with = |wheel_slips| run_ideal(Settings { duration_s: 60.0, ..Settings::default() }, wheel_slips);
    let turned = |scans: &[(ScanBuffer, Pose)]| {
        let error = |pair: &[(ScanBuffer, Pose)]| {
            pair[0].0.header.odometry.to(pair[1].0.header.odometry).turn_rad(pair[0].1.to(pair[1].1))
        };
        scans.windows(2).map(error).sum::<f64>()
    };
    let (without, slipping) = (with(0), with(4));
    assert!(turned(&without) < 1e-6);
    assert!((0.1..5.0).contains(&turned(&slipping)));
    let is_same =
        |(a, b): (&(ScanBuffer, Pose), &(ScanBuffer, Pose))| a.1 == b.1 && a.0.numbers == b.0.numbers;
    assert!(without.iter().zip(&slipping).all(is_same), "way and ranges are the same");
}

#[test]
fn noise_has_the_requested_size() {
    let exact = run_ideal(short(), 0);
    let noisy = run_with(&short(), &Errors { mixed_pixel_share: 0.0, ..Errors::default() });
    let (mut errors, mut lost, mut seen) = (Vec::new(), 0.0, 0.0);
    for ((exact, _), (noisy, _)) in exact.iter().zip(&noisy) {
        for (exact, noisy) in exact.numbers.iter().zip(&noisy.numbers).filter(|(exact, _)| **exact < 11.9) {
            seen += 1.0;
            lost += f64::from(u8::from(noisy.is_infinite()));
            errors.extend(noisy.is_finite().then(|| f64::from(noisy - exact)));
        }
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let sigma = (errors.iter().map(|e| (e - mean) * (e - mean)).sum::<f64>() / errors.len() as f64).sqrt();
    assert!((mean - 0.005).abs() < 0.001 && (sigma - 0.01).abs() < 0.001, "{mean} {sigma}");
    assert!((lost / seen - 0.01f64).abs() < 0.003, "{lost} of {seen}");
    let settings = Settings { wheel_slips: 0, ..short() };
    let mixed = run_with(&settings, &Errors { mixed_pixel_share: 0.2, ..no_errors() });
    let far_off = |(a, b): (&f32, &f32)| a.is_finite() && b.is_finite() && (a - b).abs() > 0.1;
    let pixels: usize = exact
        .iter()
        .zip(&mixed)
        .map(|((exact, _), (mixed, _))| {
            exact.numbers.iter().zip(&mixed.numbers).filter(|pair| far_off(*pair)).count()
        })
        .sum();
    assert!((300..30_000).contains(&pixels), "{pixels}");
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let settings = Settings { duration_s: 5.0, ..Settings::default() };
    assert_eq!(run(&settings), run(&settings));
    assert_ne!(run(&settings), run(&Settings { seed: 2, ..settings }));
}

#[test]
fn a_picture_can_be_driven_through() {
    let settings = Settings { duration_s: 60.0, beams: 90, ..Settings::default() };
    let pixels: Vec<u8> = (0..400 * 300)
        .map(|i| (i % 400, i / 400))
        .map(|(x, y)| {
            let wall = x % 100 == 0 && (y % 100) > 30 || y % 100 == 0 && (x % 100) > 30;
            let rim = x < 2 || y < 2 || x > 397 || y > 297;
            if wall || rim { 0 } else { 254 }
        })
        .collect();
    let world = World::Image(ImageWorld::from_grey(400, 300, 0.05, &pixels).unwrap());
    let drive = Simulation::new(&settings, world.clone()).unwrap();
    assert_eq!(drive.scans(), 600);
    let scans: Vec<_> = drive.collect();
    for (scan, truth) in &scans {
        let nearest =
            scan.numbers.iter().copied().filter(|range| range.is_finite()).fold(f32::INFINITY, f32::min);
        assert!(nearest > 0.15, "too near to a wall at {truth:?}: {nearest}");
    }
    assert!(scans.iter().any(|(_, truth)| truth.distance_m(scans[0].1) > 3.0));
    let carried = Settings { kidnap_at_s: vec![10.0, 30.0], ..settings.clone() };
    let places: Vec<_> = Simulation::new(&carried, world).unwrap().map(|(_, truth)| truth).collect();
    assert!(places[99].distance_m(places[100]) > 5.0 && places[299].distance_m(places[300]) > 5.0);
    let walled = World::Image(ImageWorld::from_grey(20, 20, 0.05, &[0; 400]).unwrap());
    assert_eq!(Simulation::new(&settings, walled).unwrap_err(), SimulationError::NoRoom);
}
