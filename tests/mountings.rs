//! Wherever lidars sit on a robot, however many they are and whatever tells how it turns: recordings with transforms give the same poses.

use crate::support::ros_recording::{RosRecording, in_space};
use crate::support::{Outputs, run_well};
use flockslam::evaluation::evaluate_truth;
use flockslam::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
use flockslam_messages::ScanBuffer;
use flockslam_simulation::{Settings, Simulation, World, WorldName};
use flockslam_transforms::Isometry3;
use nalgebra::{Translation3, UnitQuaternion};
use std::f64::consts::PI;
use std::path::Path;

/// The simulated lidars turn so often a second; those that are slower leave turns out.
const RATE_HZ: f64 = 20.0;

/// A lidar on the robot.
#[derive(Clone, Copy)]
struct Mounted {
    place: Pose,
    /// Where the transforms say that it is.
    stated: Pose,
    upside_down: bool,
    /// It gives every so many turns a scan.
    every: usize,
}

/// What tells how the robot moves.
#[derive(Clone, Copy, PartialEq)]
enum Motion {
    Wheels,
    /// Their clock is ahead of that of the lidar by so much, nanoseconds.
    WheelsAhead(i64),
    Gyroscope,
}

/// A lidar at ten turns a second, so far ahead of the middle of the robot, and looking there.
fn at(x_m: f64, heading_deg: f64) -> Mounted {
    let place = Pose::new(x_m, 0.0, heading_deg.to_radians());
    Mounted { place, stated: place, upside_down: false, every: 2 }
}

/// Writes a drive with these lidars on the robot; the exact poses at the times of its scans.
fn record(path: &Path, settings: &Settings, lidars: &[Mounted], motion: Motion) -> Vec<TrajectoryPoint> {
    let mut recording = RosRecording::create(path);
    for (number, lidar) in lidars.iter().enumerate() {
        let mut place = in_space(lidar.stated);
        place.translation.z = 0.3;
        if lidar.upside_down {
            place.rotation *= UnitQuaternion::from_euler_angles(PI, 0.0, 0.0);
        }
        recording.static_transform("base_link", &format!("laser_{number}"), &place);
    }
    // The IMU is mounted on its side: the robot turns about its y axis.
    let on_its_side = UnitQuaternion::from_euler_angles(PI / 2.0, 0.0, 0.0);
    recording.static_transform(
        "base_link",
        "imu",
        &Isometry3::from_parts(Translation3::identity(), on_its_side),
    );
    let simulated =
        |lidar: &Mounted| Simulation::new(settings, World::built_in(settings)).unwrap().mounted(lidar.place);
    let mut drives: Vec<_> = lidars.iter().map(simulated).collect();
    let (mut scan, mut truth) = (ScanBuffer::default(), Vec::new());
    for turn in 0..drives[0].scans() {
        for (number, (lidar, drive)) in lidars.iter().zip(&mut drives).enumerate() {
            let map_from_base = drive.next_scan(&mut scan).unwrap();
            let stamp_ns = scan.header.times.sensor_ns;
            if number == 0 {
                let rate_rad_s = drive.twist().turn_rad_s + GYRO_BIAS_RAD_S;
                recording.imu(stamp_ns, "imu", [0.0, rate_rad_s, 0.0]);
                match motion {
                    Motion::Wheels => recording.odometry(stamp_ns, scan.header.odometry),
                    Motion::WheelsAhead(by_ns) => recording.odometry(stamp_ns + by_ns, scan.header.odometry),
                    Motion::Gyroscope => {}
                }
                truth.push(TrajectoryPoint { stamp_ns, map_from_base });
            }
            if lidar.upside_down {
                scan.header.angle_min_rad = -scan.header.angle_min_rad;
                scan.header.angle_increment_rad = -scan.header.angle_increment_rad;
            }
            if turn.is_multiple_of(lidar.every) {
                recording.scan(&format!("/scan_{number}"), &format!("laser_{number}"), &scan);
            }
        }
    }
    recording.finish();
    truth
}

/// Drives whose mean errors are compared: that of one drive depends on the noise of its scans.
const SEEDS: std::ops::Range<u64> = 1..5;
const PLACED_SEEDS: std::ops::Range<u64> = 1..13;
/// What gyroscopes of small robots are off by.
const GYRO_BIAS_RAD_S: f64 = 0.01;

fn mapped(place: &Path, recording: &Path, more: &[String]) -> Outputs {
    let args = [&["map".to_owned(), recording.display().to_string()], more].concat();
    run_well("mounted", &place.join("out"), &args)
}

/// Mean error of the poses of a run, metres.
fn mean_error_m(outputs: &Outputs, truth: &[TrajectoryPoint]) -> f64 {
    let report = evaluate_truth(&outputs.trajectory("trajectory.tum"), truth).unwrap();
    assert_eq!(report.without_truth, 0);
    report.absolute.translation_m.unwrap().mean
}

/// Mean error of the poses of a recording, metres.
fn error_m(place: &Path, recording: &Path, more: &[String], truth: &[TrajectoryPoint]) -> f64 {
    mean_error_m(&mapped(place, recording, more), truth)
}

fn settings(world: WorldName, duration_s: f64) -> Settings {
    Settings { world, duration_s, scan_rate_hz: RATE_HZ, wheel_slips: 0, ..Settings::default() }
}

#[test]
fn lidars_wherever_and_however_many_give_true_poses() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("drive.mcap");
    let error_of = |lidars: &[Mounted]| {
        let topics = (0..lidars.len()).flat_map(|number| ["--scan".to_owned(), format!("/scan_{number}")]);
        let topics: Vec<String> = topics.collect();
        let of_seed = |seed: u64| {
            let settings = Settings { seed, ..settings(WorldName::Office, 60.0) };
            let truth = record(&file, &settings, lidars, Motion::Wheels);
            error_m(directory.path(), &file, &topics, &truth)
        };
        let errors: Vec<f64> = PLACED_SEEDS.map(of_seed).collect();
        println!("{errors:.4?}");
        errors.iter().sum::<f64>() / errors.len() as f64
    };
    // Limits: a tenth more than was reached over these seeds. One drive is off by 0.0011 m from the mean.
    let upside_down = Mounted { upside_down: true, ..at(0.3, 30.0) };
    let slower = Mounted { every: 4, ..at(-0.2, 120.0) };
    let faster = Mounted { every: 1, ..at(0.0, -120.0) };
    for (name, lidars, limit_m) in [
        ("ahead, turned and upside down", vec![upside_down], 0.0037),
        ("three rates", vec![at(0.2, 0.0), slower, faster], 0.0035),
    ] {
        let found_m = error_of(&lidars);
        println!("{name} {found_m:.4} m");
        assert!(found_m < limit_m, "{name}: {found_m} m");
    }
}

#[test]
fn a_gyroscope_stands_in_for_wheels() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("drive.mcap");
    let of_seed = |seed: u64| {
        let settings = Settings { seed, ..settings(WorldName::Hotel, 60.0) };
        let truth = record(&file, &settings, &[at(0.1, 0.0)], Motion::Gyroscope);
        error_m(directory.path(), &file, &[], &truth)
    };
    let errors: Vec<f64> = (1..=6).map(of_seed).collect();
    let mean_m = errors.iter().sum::<f64>() / errors.len() as f64;
    // A tenth more than 0.0188 m. Over ten seeds it is 0.0169 m, and 0.0128 m with wheels; single seeds 0.011 to 0.026 m. All are one way with
    // other noise, whose error depends on which scans become nodes.
    println!("{mean_m:.4} m, {errors:.4?}");
    assert!(mean_m < 0.0207, "{mean_m} m: {errors:?}");
}

#[test]
fn a_wrong_mounting_and_an_offset_in_time_are_estimated_and_used_when_asked() {
    let directory = tempfile::tempdir().unwrap();
    let (place, file) = (directory.path(), directory.path().join("drive.mcap"));
    let (mut right_m, mut calibrated_m) = (0.0, 0.0);
    for seed in SEEDS {
        let settings = Settings { seed, ..settings(WorldName::Office, 90.0) };
        let (exact, sign) = (Pose::new(0.2, 0.05, 0.3), if seed % 2 == 0 { -1.0 } else { 1.0 });
        let right = Mounted { place: exact, stated: exact, ..at(0.0, 0.0) };
        let truth = record(&file, &settings, &[right], Motion::Wheels);
        right_m += error_m(place, &file, &[], &truth);
        // 5 cm and 3° are wrong, and 40 ms.
        let stated = Pose::new(0.2 - 0.04 * sign, 0.05 - 0.03 * sign, 0.3 + sign * 3f64.to_radians());
        let wrong = Mounted { stated, ..right };
        let truth = record(&file, &settings, &[wrong], Motion::WheelsAhead(sign as i64 * 40_000_000));
        let report = mapped(place, &file, &[]).report;
        let [row] = report.calibration.as_slice() else { panic!("{:?}", report.calibration) };
        let exact = [exact.x_m, exact.y_m, exact.heading_rad.to_degrees(), 0.04 * sign];
        println!("{:.4?} ± {:.4?}", row.estimate, row.deviation);
        assert_eq!(row.known, [true; 4]);
        for ((found, exact), limit) in row.estimate.iter().zip(exact).zip([0.01, 0.01, 0.5, 0.005]) {
            assert!((found - exact).abs() < limit, "seed {seed}: {:?} ± {:?}", row.estimate, row.deviation);
        }
        let calibrate = ["--set", "lidar_ingest.calibrate=true"].map(str::to_owned);
        calibrated_m += error_m(place, &file, &calibrate, &truth);
    }
    println!("{right_m:.4} m, {calibrated_m:.4} m");
    assert!(calibrated_m < 1.1 * right_m, "{calibrated_m} m, {right_m} m");
}
