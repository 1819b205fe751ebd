//! What nothing connects with the map: said while the set runs, and written beside the map at its end.

use crate::support::{Drive, LiveSet, machine_share, wait_for};
use flockslam::supervisor::SetStatus;
use flockslam_messages::Stage;
use flockslam_stage::metrics_socket;
use flockslam_telemetry::{names, scrape};
use std::time::Duration;

/// A drive that the test ends, and a shorter one.
const FIRST: Drive = Drive { scan_rate_hz: 10.0, duration_s: 3000.0, rate: 6.0 };
const SECOND: Drive = Drive { scan_rate_hz: 10.0, duration_s: 40.0, rate: 6.0 };

#[test]
fn a_drive_in_another_building_is_reported_as_unattached_and_gets_its_own_map() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let keeps = format!("map = {:?}\nsave_every_s = 0.2", directory.path().join("map"));
    let mut first = LiveSet::start("apart1", directory.path(), FIRST, &keeps);
    let status = first.wait_until_handled(Stage::SyncManager, 600);
    assert_eq!(status.unattached, None);
    first.command_well(&["down"]);
    assert_eq!(first.wait(), Some(0));

    // The map is continued, but in a building that it does not show.
    let elsewhere = ["--set", "simulation.world=warehouse"].map(str::to_owned);
    let mut second =
        LiveSet::start_with_failpoints("apart2", directory.path(), SECOND, &keeps, &elsewhere, "");
    let is_apart = |status: &SetStatus| status.unattached.is_some_and(|unattached| unattached.travel_m > 1.0);
    let unattached = second.wait_until("a drive that is unattached", is_apart).unattached.unwrap();
    assert!(unattached.scans > 0, "{unattached:?}");
    let text = String::from_utf8(second.command_well(&["status"]).stdout).unwrap();
    assert!(text.contains("  NOT IN THE MAP: "), "{text}");
    let socket = metrics_socket(&second.runtime_dir().join("status"), "sync-manager-0");
    for metric in [names::UNATTACHED_SCANS, names::UNATTACHED_TRAVEL] {
        let page = wait_for("a page", || scrape(&socket, Duration::from_secs(1)).ok());
        let line = page.lines().find(|line| line.starts_with(&format!("{}{{", metric.name)));
        let value = line.and_then(|line| line.rsplit(' ').next()).and_then(|value| value.parse::<f64>().ok());
        assert!(value.is_some_and(|value| value >= 1.0), "{}: {line:?}", metric.name);
    }

    let outputs = second.finish();
    let report = &outputs.report;
    assert_eq!((report.trajectories, report.detached.len()), (2, 1));
    let row = &report.detached[0];
    assert_eq!((row.trajectory, row.scans), (1, report.detached_scans), "{row:?}");
    assert!(row.scans >= unattached.scans, "{row:?}, {unattached:?}");
    assert!(row.travel_m >= unattached.travel_m - 0.5 && row.to_s > row.from_s, "{row:?}, {unattached:?}");
    assert_eq!(outputs.lines("trajectory.tum").len() as u64, report.scans, "each scan has a pose");
    assert_eq!(row.directory.as_deref(), Some("trajectory-2"));
    assert_eq!(outputs.lines("trajectory-2/trajectory.tum").len() as u64, row.scans);
    for name in ["map.pgm", "map.yaml", "map.png"] {
        assert!(!outputs.bytes(&format!("trajectory-2/{name}")).is_empty());
    }
    assert_ne!(outputs.bytes("trajectory-2/map.png"), outputs.bytes("map.png"));
}
