//! What scans get from transforms, odometry and turns, recorded and live.

use super::*;
use crate::settings::{LidarCalibration, LidarMounting};
use flockslam_messages::HEADING_ONLY;
use flockslam_transforms::Isometry3;
use nalgebra::Vector3;

const MS: i64 = 1_000_000;

fn locator_of(lidars: &[LidarMounting]) -> ScanLocator {
    let settings = Settings { lidars: lidars.to_vec(), ..Settings::default() };
    ScanLocator::new(&settings, 1, false)
}

fn scan_in(frame: &str, stamp_ms: i64) -> Sighting {
    let mut scan = ScanBuffer::from_ranges(&[1.0, 2.0], -0.5, 1.0);
    scan.header.times.sensor_ns = stamp_ms * MS;
    Sighting::Scan(FramedScan { frame: frame.to_owned(), scan, mounting: None })
}

fn scan(stamp_ms: i64) -> Sighting {
    scan_in("/laser", stamp_ms)
}

fn transform(stamp_ms: i64, parent: &str, child: &str, x_m: f64) -> StampedTransform {
    StampedTransform {
        stamp_ns: stamp_ms * MS,
        parent: parent.to_owned(),
        child: child.to_owned(),
        parent_from_child: Isometry3::translation(x_m, 0.0, 0.0),
    }
}

fn stamp_ms(scan: &ScanBuffer) -> i64 {
    scan.header.times.sensor_ns / MS
}

#[test]
fn odometry_is_interpolated_at_the_time_of_the_scan_whatever_comes_first() {
    let mut locator = locator_of(&[]);
    locator.push_transforms(0, &[transform(0, "base_link", "laser", 0.3)], true);
    locator.push_sighting(100 * MS, 0, scan(100));
    locator.push_transforms(160 * MS, &[transform(150, "odom", "base_link", 1.5)], false);
    locator.push_transforms(170 * MS, &[transform(50, "odom", "base_link", 0.5)], false);
    assert_eq!(locator.take(false), Ok(None), "more may come");
    let found = locator.take(true).unwrap().unwrap();
    assert_eq!((found.header.base_from_laser.x_m, found.header.has_odometry), (0.3, 1));
    assert!((found.header.odometry.x_m - 1.0).abs() < 1e-12);
    assert_eq!(locator.take(true), Ok(None));
}

/// A scan that takes a tenth of a second.
fn slow_scan(at_ms: i64) -> Sighting {
    let Sighting::Scan(mut scan) = scan(at_ms) else { unreachable!() };
    let beams = scan.scan.header.beam_count;
    scan.scan.header.time_increment_s = 0.1 / (beams - 1) as f32;
    Sighting::Scan(scan)
}

/// How fast the robot went ahead while a scan was taken, by its odometry.
fn speed_m_s(scan: &ScanBuffer) -> Option<f64> {
    scan.view().unwrap().odometry_twist().map(|twist| twist.x_m_s)
}

#[test]
fn a_scan_that_takes_time_waits_for_odometry_at_its_last_beam() {
    let mut locator = locator_of(&[]);
    let odometry =
        |at_ms: i64, x_m: f64| OdometryReading { transform: transform(at_ms, "odom", "", x_m), twist: None };
    locator.push_odometry(0, &odometry(0, 0.0));
    locator.push_sighting(0, 0, scan(0));
    locator.note_time(2000 * MS);
    assert_eq!(speed_m_s(&locator.take(false).unwrap().unwrap()), None, "taken at once");
    locator.push_sighting(2110 * MS, 0, slow_scan(2010));
    locator.push_odometry(2111 * MS, &odometry(2000, 0.0));
    locator.push_odometry(2112 * MS, &odometry(2050, 0.05));
    assert_eq!(locator.take(false), Ok(None), "odometry at the last beam may come");
    locator.push_odometry(2150 * MS, &odometry(2150, 0.17));
    let found = locator.take(false).unwrap().unwrap();
    // From 0.01 m at the first beam to 0.122 m at the last.
    assert!((speed_m_s(&found).unwrap() - 1.12).abs() < 1e-3, "{found:?}");
}

#[test]
fn live_odometry_that_reaches_over_half_of_a_scan_is_carried_on_to_its_end() {
    for (known_ms, expected) in [(30, None), (90, Some(1.0))] {
        let mut locator = live();
        let odometry = |at_ms: i64| OdometryReading {
            transform: transform(at_ms, "odom", "", 1e-3 * at_ms as f64),
            twist: None,
        };
        locator.set_lidars(1);
        locator.push_transforms(0, &[transform(0, "base_link", "laser", 0.3)], true);
        (0..=known_ms).step_by(10).for_each(|at_ms| locator.push_odometry(at_ms * MS, &odometry(at_ms)));
        locator.push_sighting(110 * MS, 0, slow_scan(10));
        let found = locator.take(false).unwrap().unwrap();
        assert_eq!(speed_m_s(&found).map(|speed| (speed * 1e4).round() * 1e-4), expected);
    }
}

#[test]
fn scans_wait_for_odometry_and_not_for_ever() {
    let mut locator = locator_of(&[]);
    let odometry = |at_ms: i64| OdometryReading { transform: transform(at_ms, "odom", "", 1.0), twist: None };
    locator.push_odometry(0, &odometry(0));
    locator.push_sighting(10 * MS, 0, scan(10));
    locator.push_sighting(2100 * MS, 0, scan(2100));
    let first = locator.take(false).unwrap().unwrap();
    assert_eq!((stamp_ms(&first), first.header.has_odometry), (10, 1), "the pose before is not too old");
    assert_eq!(locator.take(false), Ok(None));
    locator.push_sighting(2700 * MS, 0, scan(2700));
    let second = locator.take(false).unwrap().unwrap();
    assert_eq!((stamp_ms(&second), second.header.has_odometry), (2100, 0));
}

#[test]
fn without_any_transform_the_lidar_is_the_robot_and_with_others_it_is_refused() {
    let mut locator = locator_of(&[]);
    locator.push_sighting(0, 0, scan(0));
    let alone = locator.take(true).unwrap().unwrap();
    assert_eq!((alone.header.base_from_laser, alone.header.has_odometry), (Pose::IDENTITY, 0));
    let mut locator = locator_of(&[]);
    locator.push_transforms(0, &[transform(0, "odom", "base_link", 0.0)], false);
    locator.push_sighting(0, 0, scan(0));
    let error = locator.take(true).unwrap_err().to_string();
    assert!(error.contains("'laser'") && error.contains("lidar_ingest.lidars"), "{error}");
    let given = LidarMounting { x_m: 0.2, upside_down: true, ..LidarMounting::default() };
    let mut locator = locator_of(&[given]);
    locator.push_transforms(0, &[transform(0, "odom", "base_link", 0.0)], false);
    locator.push_sighting(0, 0, scan(0));
    let found = locator.take(true).unwrap().unwrap();
    assert_eq!(found.header.base_from_laser.x_m, 0.2);
    assert_eq!((found.header.angle_min_rad, found.header.angle_increment_rad), (0.5, -1.0));
}

#[test]
fn scans_of_several_lidars_come_in_the_order_of_time_each_from_its_place() {
    let mut locator = ScanLocator::new(&Settings::default(), 2, false);
    let places = [transform(0, "base_link", "front", 0.3), transform(0, "base_link", "rear", -0.3)];
    locator.push_transforms(0, &places, true);
    for (recorded_ms, lidar, frame, stamp_ms) in [
        (10, 0, "front", 5),
        (20, 0, "front", 15),
        (30, 1, "rear", 2),
        (40, 1, "rear", 12),
        (50, 0, "front", 25),
    ] {
        locator.push_sighting(recorded_ms * MS, lidar, scan_in(frame, stamp_ms));
    }
    assert_eq!(locator.take(false), Ok(None), "one of the other may still come");
    let found: Vec<_> = std::iter::from_fn(|| locator.take(true).unwrap())
        .map(|scan| (stamp_ms(&scan), scan.header.id.lidar, scan.header.base_from_laser.x_m))
        .collect();
    assert_eq!(found, [(2, 1, -0.3), (5, 0, 0.3), (12, 1, -0.3), (15, 0, 0.3), (25, 0, 0.3)]);
}

#[test]
fn without_odometry_the_gyro_gives_the_heading_and_where_it_leads_all_turns() {
    for gyro_leads in [false, true] {
        for has_odometry in [false, true] {
            let mut locator = ScanLocator::new(&Settings::default(), 1, gyro_leads);
            for stamp_ms in [0, 100, 200] {
                let turn_rad_s = Vector3::new(0.0, 0.0, 1.0);
                let reading = ImuReading { stamp_ns: stamp_ms * MS, frame: "imu".to_owned(), turn_rad_s };
                locator.push_imu(stamp_ms * MS, reading);
                if has_odometry {
                    let transform = transform(stamp_ms, "odom", "", 0.01 * stamp_ms as f64);
                    locator.push_odometry(stamp_ms * MS, &OdometryReading { transform, twist: None });
                }
            }
            locator.push_sighting(100 * MS, 0, scan(100));
            locator.push_sighting(200 * MS, 0, scan(200));
            let found = [(); 2].map(|()| locator.take(true).unwrap().unwrap().header);
            let motion = found[0].odometry.to(found[1].odometry);
            let expected = match (has_odometry, gyro_leads) {
                (false, _) => (HEADING_ONLY, 0.0, 0.1),
                (true, false) => (1, 1.0, 0.0),
                (true, true) => (1, 1.0, 0.1),
            };
            assert_eq!(found[1].has_odometry, expected.0);
            assert!((motion.heading_rad - expected.2).abs() < 1e-9, "{has_odometry} {gyro_leads}");
            let travel_m = if has_odometry { motion.x_m } else { 0.0 };
            assert!((travel_m - expected.1).abs() < 1e-9, "{has_odometry} {gyro_leads}");
        }
    }
}

fn live() -> ScanLocator {
    ScanLocator::live(&Settings::default(), false)
}

fn odometry(at_ms: i64, x_m: f64, twist: Option<Twist>) -> OdometryReading {
    OdometryReading { transform: transform(at_ms, "odom", "base_link", x_m), twist }
}

#[test]
fn live_a_scan_waits_a_moment_for_odometry_and_is_then_carried_on_by_its_speed() {
    for twist in [None, Some(Twist { x_m_s: 1.0, ..Twist::default() })] {
        let mut locator = live();
        locator.push_transforms(0, &[transform(0, "base_link", "laser", 0.3)], true);
        for at_ms in [800, 900, 1000] {
            locator.push_odometry(at_ms * MS, &odometry(at_ms, 0.001 * at_ms as f64, twist));
        }
        locator.push_sighting(1010 * MS, 0, scan(950));
        let between = locator.take(false).unwrap().unwrap();
        assert!((between.header.odometry.x_m - 0.95).abs() < 1e-12, "what is there is not waited for");
        locator.push_sighting(1040 * MS, 0, scan(1040));
        assert_eq!(locator.take(false), Ok(None), "odometry may still come");
        locator.note_time(1089 * MS);
        assert_eq!(locator.take(false), Ok(None));
        locator.note_time(1090 * MS);
        let late = locator.take(false).unwrap().unwrap();
        assert!((late.header.odometry.x_m - 1.04).abs() < 1e-9, "{}", late.header.odometry.x_m);
        assert_eq!(locator.guesses(), MotionGuesses { extrapolated: 1, without: 0 });
    }
}

#[test]
fn live_odometry_that_is_silent_is_not_waited_for() {
    let mut locator = live();
    locator.push_transforms(0, &[transform(0, "base_link", "laser", 0.3)], true);
    locator.push_odometry(0, &odometry(0, 0.0, None));
    locator.push_sighting(600 * MS, 0, scan(600));
    let found = locator.take(false).unwrap().unwrap();
    assert_eq!((found.header.has_odometry, locator.guesses().without), (0, 1));
}

#[test]
fn live_a_transform_that_comes_late_places_the_scans_that_follow() {
    let mut locator = live();
    locator.push_sighting(0, 0, scan(0));
    assert_eq!(locator.take(false), Ok(None), "transforms may still come");
    locator.note_time(1000 * MS);
    assert_eq!(locator.take(false).unwrap().unwrap().header.base_from_laser, Pose::IDENTITY);
    locator.push_transforms(1100 * MS, &[transform(1100, "odom", "base_link", 1.0)], false);
    locator.push_sighting(1150 * MS, 0, scan(1100));
    locator.note_time(2150 * MS);
    assert!(locator.take(false).is_err(), "nothing leads to the lidar");
    assert_eq!(locator.give_up(), Some(0));
    locator.push_transforms(2200 * MS, &[transform(0, "base_link", "laser", 0.3)], true);
    locator.push_sighting(2210 * MS, 0, scan(1100));
    let found = locator.take(false).unwrap().unwrap();
    assert_eq!((found.header.base_from_laser.x_m, found.header.odometry.x_m), (0.3, 1.0));
}

#[test]
fn the_mounting_of_a_driver_is_used_unless_settings_override_it() {
    let place = Mounting { base_from_laser: Pose::new(0.2, 0.0, 0.0), upside_down: true };
    let given = |stamp_ms| match scan(stamp_ms) {
        Sighting::Scan(scan) => Sighting::Scan(FramedScan { mounting: Some(place), ..scan }),
        Sighting::Cloud(_) => unreachable!(),
    };
    let mut locator = live();
    locator.push_sighting(0, 0, given(0));
    let found = locator.take(false).unwrap().unwrap();
    assert_eq!((found.header.base_from_laser, found.header.angle_min_rad), (place.base_from_laser, 0.5));
    let lidars = vec![LidarMounting { x_m: 0.5, ..LidarMounting::default() }];
    let settings = Settings { lidars, ..Settings::default() };
    let mut locator = ScanLocator::live(&settings, false);
    locator.push_sighting(0, 0, given(0));
    let found = locator.take(false).unwrap().unwrap();
    assert_eq!((found.header.base_from_laser.x_m, found.header.angle_min_rad), (0.5, -0.5));
}

#[test]
fn live_several_lidars_are_brought_into_order_and_none_that_died_is_waited_for() {
    let mut locator = live();
    let places = [transform(0, "base_link", "front", 0.3), transform(0, "base_link", "rear", -0.3)];
    locator.push_transforms(0, &places, true);
    let mut found = Vec::new();
    // The rear lidar is half a turn behind, and its scans come 70 ms later than those of the other.
    for step in 0..12 {
        let front_ms = 100 * step;
        let mut arrivals = vec![(front_ms + 10, 0, "front", front_ms)];
        if step < 6 {
            arrivals.push((front_ms + 70, 1, "rear", front_ms - 10));
        }
        for (received_ms, lidar, frame, seen_ms) in arrivals {
            locator.push_sighting(received_ms * MS, lidar, scan_in(frame, seen_ms));
            while let Some(scan) = locator.take(false).unwrap() {
                found.push((received_ms, scan.header.id.lidar, stamp_ms(&scan)));
            }
            // Between two scans the clock goes on.
            locator.note_time((received_ms + 59) * MS);
            while let Some(scan) = locator.take(false).unwrap() {
                found.push((received_ms + 59, scan.header.id.lidar, stamp_ms(&scan)));
            }
        }
    }
    let of = |lidar: u32| found.iter().filter(|found| found.1 == lidar).count();
    assert_eq!((of(0), of(1)), (12, 6), "{found:?}");
    let waits = found.iter().filter(|(_, lidar, _)| *lidar == 0).map(|(at_ms, _, stamp_ms)| at_ms - stamp_ms);
    assert!(waits.clone().all(|wait_ms| wait_ms <= 69), "{found:?}");
    assert!(waits.skip(9).all(|wait_ms| wait_ms == 10), "a lidar that died is not waited for: {found:?}");
}

#[test]
fn odometry_of_a_lidar_whose_clock_is_off_is_that_of_its_time() {
    let calibration = vec![LidarCalibration { offset_s: 0.04, ..LidarCalibration::default() }];
    let mut locator = ScanLocator::new(&Settings { calibration, ..Settings::default() }, 1, false);
    for at_ms in [0, 100, 200] {
        let transform = transform(at_ms, "odom", "", 0.01 * at_ms as f64);
        locator.push_odometry(at_ms * MS, &OdometryReading { transform, twist: None });
    }
    locator.push_sighting(100 * MS, 0, scan(100));
    let found = locator.take(true).unwrap().unwrap();
    assert!(stamp_ms(&found) == 100 && (found.header.odometry.x_m - 1.4).abs() < 1e-9);
}
