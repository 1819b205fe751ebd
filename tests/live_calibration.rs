//! Where the lidar of a running set sits is said by its drive.

use crate::support::machine_share;
use crate::support::{Drive, LiveSet};
use flockslam_messages::Stage;

/// A drive that the test ends.
const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 3000.0, rate: 6.0 };
/// So many scans show it: more than a minute of driving.
const SCANS: u64 = 700;
/// The simulated lidar sits so far ahead of the middle of the robot, metres, and looks ahead.
const AHEAD_M: f64 = 0.1;
/// Metres and degrees: wheels slip now and then.
const OFF_MAX: (f64, f64) = (0.03, 1.0);

#[test]
fn a_running_set_reports_the_mounting_of_its_lidar() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("calibrated", directory.path(), DRIVE, "");
    set.wait_until_handled(Stage::SyncManager, SCANS);
    let text = String::from_utf8(set.command_well(&["lidar", "calibrate"]).stdout).unwrap();
    println!("{text}");
    // The simulated lidar sees nothing of its robot.
    let mask = set.command_well(&["lidar", "learn-mask", "--seconds", "5"]).stdout;
    assert_eq!(String::from_utf8(mask).unwrap(), "[lidar_ingest]\nself_mask = []\n");
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));

    let found: toml::Table = toml::from_str(text.split_once('\n').unwrap().1).unwrap();
    let lidar = &found["lidar_ingest"]["calibration"][0];
    let number = |key: &str| lidar[key].as_float().unwrap();
    assert!((number("x_m") - AHEAD_M).abs() < OFF_MAX.0 && number("y_m").abs() < OFF_MAX.0, "{text}");
    assert!(number("heading_deg").abs() < OFF_MAX.1, "{text}");
}
