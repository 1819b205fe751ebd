use super::*;
use flockslam_geometry::{Point, Twist};
use flockslam_messages::ScanView;
use std::time::Instant;

fn short() -> Settings {
    Settings { duration_s: 30.0, ..Settings::default() }
}

/// A lidar and wheels without errors.
fn ideal(settings: Settings) -> Settings {
    Settings {
        range_sigma_m: 0.0,
        range_bias_m: 0.0,
        mixed_pixel_share: 0.0,
        dropout_share: 0.0,
        odometry_scale_error: 0.0,
        odometry_walk: [0.0; 2],
        wheel_slips: 0,
        ..settings
    }
}

fn run(settings: &Settings) -> Vec<(ScanBuffer, Pose)> {
    Simulation::new(settings, World::floor_plan()).unwrap().collect()
}

/// Bounded motion, clear of walls, everywhere at least twice.
#[test]
fn the_demo_drives_through_the_whole_building() {
    let started = Instant::now();
    let settings = Settings::default();
    let scans = run(&settings);
    eprintln!("{} scans simulated in {:.2?}", scans.len(), started.elapsed());
    assert_eq!(scans.len(), 2500);
    let World::FloorPlan(plan) = World::floor_plan() else { unreachable!() };
    let nearest_m =
        scans.iter().map(|(_, truth)| plan.distance_m(truth.position())).fold(f64::INFINITY, f64::min);
    let driven_m: f64 = scans.windows(2).map(|pair| pair[0].1.distance_m(pair[1].1)).sum();
    eprintln!("{driven_m:.0} m driven, nearest wall {nearest_m:.2} m");
    assert!(nearest_m > 0.25 && driven_m > 120.0);
    for pair in scans.windows(2) {
        let twist = Twist::from_motion(pair[0].1.to(pair[1].1), 0.1);
        assert!(
            twist.x_m_s < settings.speed_m_s + 1e-6 && twist.turn_rad_s.abs() < settings.turn_rad_s + 1e-6
        );
        assert!(twist.y_m_s.abs() < 0.05);
    }
    for (i, point) in plan.way_points().iter().enumerate() {
        let visited = scans.iter().any(|(_, truth)| truth.position().distance_m(*point) < 0.6);
        assert!(visited, "way point {i} is not visited");
    }
    let (first, last) = (&scans[0].1, &scans[scans.len() - 200..]);
    assert!(last.iter().any(|(_, truth)| truth.distance_m(*first) < 3.0), "the drive does not come back");
}

/// Each beam of an ideal lidar ends on a wall, seen from where the robot is at that beam's time.
#[test]
fn ranges_belong_to_the_moving_pose() {
    let scans = run(&ideal(short()));
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
    let scans = run(&ideal(short()));
    let start = scans[0].1;
    assert!(scans.iter().all(|(scan, truth)| (start * scan.header.odometry).distance_m(*truth) < 1e-6));
    let drifting = run(&Settings::default());
    let (last, truth) = drifting.last().unwrap();
    let drift_m = (drifting[0].1 * last.header.odometry).distance_m(*truth);
    assert!((0.5..60.0).contains(&drift_m), "{drift_m}");
}

#[test]
fn a_slip_turns_odometry_only() {
    let with =
        |wheel_slips| ideal(Settings { duration_s: 60.0, ..Settings::default() }).with_slips(wheel_slips);
    let turned = |scans: &[(ScanBuffer, Pose)]| {
        let error = |pair: &[(ScanBuffer, Pose)]| {
            pair[0].0.header.odometry.to(pair[1].0.header.odometry).turn_rad(pair[0].1.to(pair[1].1))
        };
        scans.windows(2).map(error).sum::<f64>()
    };
    assert!(turned(&run(&with(0))) < 1e-6);
    assert!((0.1..5.0).contains(&turned(&run(&with(4)))));
}

impl Settings {
    fn with_slips(self, wheel_slips: u32) -> Self {
        Self { wheel_slips, ..self }
    }
}

#[test]
fn noise_has_the_size_that_was_asked_for() {
    let exact = run(&ideal(short()));
    let noisy = run(&Settings { mixed_pixel_share: 0.0, ..short() });
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
    let mixed = run(&Settings { range_sigma_m: 0.0, mixed_pixel_share: 0.2, ..ideal(short()) });
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
    let walled = World::Image(ImageWorld::from_grey(20, 20, 0.05, &[0; 400]).unwrap());
    assert_eq!(Simulation::new(&settings, walled).unwrap_err(), SimulationError::NoRoom);
}
