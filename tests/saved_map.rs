//! A map outlives its set: it is saved while the set runs, continued by the next one, checked, loaded and exported.

mod support;

use flockslam::store::SavedMap;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::fs;
use std::path::Path;
use support::{Drive, LiveSet, Outputs, flockslam, of, send, stderr, wait_for};

const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 60.0, rate: 6.0 };
/// A drive that no test sees the end of.
const LONG: Drive = Drive { scan_rate_hz: 10.0, duration_s: 3000.0, rate: 6.0 };

fn keeps(map: &Path) -> String {
    format!("map = {map:?}\nsave_every_s = 0.2")
}

#[test]
fn the_next_set_continues_a_saved_map_and_a_closure_attaches_it() {
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    let mut first = LiveSet::start("first", directory.path(), LONG, &keeps(&map));
    first.wait_until_handled(Stage::ScanMatcher, 400);
    first.command_well(&["down"]);
    assert_eq!(first.wait(), Some(0));
    let saved = SavedMap::at(&map).check().unwrap();
    println!("saved: {saved:?}");
    assert!(saved.problems.is_empty() && saved.poses >= 400 && saved.submaps > 0);
    // The same drive from its start: the robot has been carried back there.
    let second = LiveSet::start("second", directory.path(), DRIVE, &keeps(&map));
    let outputs = second.finish();
    let report = &outputs.report;
    println!("{} chains, {} detached scans, {} scans", report.chains, report.detached_scans, report.scans);
    assert_eq!((report.chains, report.detached_scans), (2, 0));
    assert!(outputs.lines("trajectory.tum").len() as u64 >= saved.poses + DRIVE.scans() as u64 * 9 / 10);
    let both = SavedMap::at(&map).check().unwrap();
    assert!(both.problems.is_empty() && both.poses == report.scans, "{both:?}");

    let out = directory.path().join("exported");
    let exported = flockslam().args(["store", "export"]).arg(&map).arg("--out").arg(&out).output().unwrap();
    assert!(exported.status.success(), "{}", stderr(&exported));
    let exported = Outputs::read(&out);
    assert_eq!(exported.report.scans, report.scans);
    let share = exported.report.map_area_m2 / report.map_area_m2;
    println!("exported {share:.3} of the area");
    assert!((0.97..1.03).contains(&share), "{share}");
}

#[test]
fn a_running_set_saves_elsewhere_and_goes_on_with_what_it_is_given() {
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("orders", directory.path(), LONG, "");
    set.wait_until_handled(Stage::ScanMatcher, 60);
    let copy = directory.path().join("copy");
    set.command_well(&["store", "save", copy.to_str().unwrap()]);
    let saved = SavedMap::at(&copy).check().unwrap();
    assert!(saved.problems.is_empty() && saved.poses >= 60);
    set.command_well(&["store", "load", copy.to_str().unwrap()]);
    set.wait_until_handled(Stage::ScanMatcher, 10);
    let nowhere = set.command(&["store", "load", "/no/such/map"]);
    assert_eq!(nowhere.status.code(), Some(2));
    let status = set.status().unwrap();
    assert!(of(&status, Stage::ScanMatcher).handled >= 10);
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn damage_is_found_and_told() {
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    let mut set = LiveSet::start("damage", directory.path(), LONG, &keeps(&map));
    set.wait_until_handled(Stage::ScanMatcher, 100);
    send(set.supervisor_pid(), Signal::TERM);
    assert_eq!(set.wait(), Some(0));
    let check = || flockslam().args(["store", "check"]).arg(&map).output().unwrap();
    assert_eq!(check().status.code(), Some(0), "{}", stderr(&check()));
    let journal = map.join("scans.journal");
    let mut bytes = fs::read(&journal).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 16;
    fs::write(&journal, bytes).unwrap();
    let told = check();
    assert_eq!((told.status.code(), stderr(&told).contains("damaged")), (Some(1), true));
    let absent = flockslam().args(["store", "check"]).arg(directory.path()).output().unwrap();
    assert_eq!(absent.status.code(), Some(2));
}

#[test]
fn a_disk_that_refuses_leaves_the_poses_alone_and_is_told() {
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    fs::write(&map, b"in the way").unwrap();
    let mut set = LiveSet::start("full", directory.path(), LONG, &keeps(&map));
    let status = set.wait_until("a problem to be told", |status| {
        status.saved.as_ref().is_some_and(|saved| saved.problem.is_some())
    });
    println!("{status}");
    let before = of(&status, Stage::ScanMatcher).handled;
    set.wait_until_handled(Stage::ScanMatcher, before + 20);
    fs::remove_file(&map).unwrap();
    set.wait_until("the map to be saved", |status| status.saved.as_ref().is_some_and(|saved| saved.durable));
    wait_for("a whole map", || SavedMap::at(&map).check().ok().filter(|found| found.poses > before));
    send(set.supervisor_pid(), Signal::TERM);
    assert_eq!(set.wait(), Some(0));
    assert!(SavedMap::at(&map).check().unwrap().problems.is_empty());
}

/// Maps of formats that are or were in use, by name: each stays readable. A build that writes another format adds its own beside
/// them (`flockslam up` with a map directory, a drive of a few seconds).
const GOLDEN: [(&str, u64, u64, u32); 1] = [("map-1", 60, 28, 3)];

#[test]
fn maps_of_all_formats_so_far_are_read() {
    for (name, poses, accepted, submaps) in GOLDEN {
        let directory = support::repository().join("tests/golden").join(name);
        let found = SavedMap::at(&directory).check().unwrap();
        assert_eq!((found.poses, found.accepted, found.submaps), (poses, accepted, submaps), "{found:?}");
        assert!(found.problems.is_empty(), "{found:?}");
        let out = tempfile::tempdir().unwrap();
        let mut export = flockslam();
        let exported = export.args(["store", "export"]).arg(&directory).arg("--out").arg(out.path()).output();
        let exported = exported.unwrap();
        assert!(exported.status.success(), "{name}: {}", stderr(&exported));
        assert_eq!(Outputs::read(out.path()).report.scans, poses);
    }
}
