//! A map outlives its set: it is saved while the set runs, continued by the next one, checked, loaded and exported.

use crate::support;
use crate::support::machine_share;
use crate::support::{Drive, LiveSet, Outputs, flockslam, not_tested, of, send, stderr, wait_for};
use flockslam::store::SavedMap;
use flockslam::supervisor::SetStatus;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::fs;
use std::path::Path;
use std::process::Command;

const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 60.0, rate: 6.0 };
/// A drive that no test sees the end of.
const LONG: Drive = Drive { scan_rate_hz: 10.0, duration_s: 3000.0, rate: 6.0 };

fn keeps(map: &Path) -> String {
    format!("map = {map:?}\nsave_every_s = 0.2")
}

#[test]
fn the_next_set_continues_a_saved_map_and_a_closure_attaches_it() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    let mut first = LiveSet::start("first", directory.path(), LONG, &keeps(&map));
    first.wait_until_handled(Stage::ScanMatcher, 400);
    first.command_well(&["down"]);
    assert_eq!(first.wait(), Some(0));
    let saved = SavedMap::at(&map).check().unwrap();
    println!("saved: {saved:?}");
    assert!(saved.problems.is_empty() && saved.poses >= 400 && saved.submaps > 0);
    // The same drive from its start: the robot has been moved back there.
    let second = LiveSet::start("second", directory.path(), DRIVE, &keeps(&map));
    let outputs = second.finish();
    let report = &outputs.report;
    println!(
        "{} trajectories, {} detached scans, {} scans",
        report.trajectories, report.detached_scans, report.scans
    );
    assert_eq!((report.trajectories, report.detached_scans), (2, 0));
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
    machine_share::mostly_waits();
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
    // The stages are new processes, and what they add is added to what was given.
    let again = directory.path().join("again");
    set.command_well(&["store", "save", again.to_str().unwrap()]);
    let both = SavedMap::at(&again).check().unwrap();
    assert!(both.problems.is_empty() && both.poses >= saved.poses + 10, "{both:?}, loaded {saved:?}");
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn damage_is_found_and_reported() {
    machine_share::mostly_waits();
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
    let text = check();
    assert_eq!((text.status.code(), stderr(&text).contains("damaged")), (Some(1), true));
    let absent = flockslam().args(["store", "check"]).arg(directory.path()).output().unwrap();
    assert_eq!(absent.status.code(), Some(2));
}

#[test]
fn a_disk_that_refuses_leaves_the_poses_alone_and_is_reported() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    fs::write(&map, b"in the way").unwrap();
    let mut set = LiveSet::start("full", directory.path(), LONG, &keeps(&map));
    let status = set.wait_until("a reported problem", |status| {
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

/// Mounts a small filesystem that only the set sees, fills it but for a few kilobytes, and becomes the set.
const FULL_DISK: &str =
    "mount -t tmpfs -o size=2m none \"$0\" && head -c 2040k /dev/zero > \"$0/ballast\" && exec \"$@\"";

fn in_a_namespace() -> Command {
    let mut command = Command::new("unshare");
    command.args(["--mount", "--map-root-user"]);
    command
}

#[test]
fn a_full_disk_leaves_the_poses_alone_until_there_is_room_again() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let disk = directory.path().join("disk");
    fs::create_dir(&disk).unwrap();
    let may_mount = in_a_namespace().args(["mount", "-t", "tmpfs", "none"]).arg(&disk).status();
    if !may_mount.is_ok_and(|status| status.success()) {
        not_tested("a full disk", "no filesystem may be mounted");
        return;
    }
    let mut command = in_a_namespace();
    command.args(["sh", "-c", FULL_DISK]).arg(&disk).arg(env!("CARGO_BIN_EXE_flockslam"));
    let mut set = LiveSet::start_by(command, "disk", directory.path(), LONG, &keeps(&disk.join("map")));
    let problem = |status: &SetStatus| status.saved.as_ref().and_then(|saved| saved.problem.clone());
    let status = set.wait_until("a full disk", |status| problem(status).is_some());
    println!("{status}");
    assert!(problem(&status).unwrap().contains("No space left"), "{status}");
    let before = of(&status, Stage::ScanMatcher).handled;
    let status = set.wait_until_handled(Stage::ScanMatcher, before + 60);
    assert!(problem(&status).is_some(), "{status}");
    // The set's own view of the disk.
    let inside = format!("/proc/{}/root{}", set.supervisor_pid(), disk.display());
    fs::remove_file(format!("{inside}/ballast")).unwrap();
    set.wait_until("the map to be saved", |status| status.saved.as_ref().is_some_and(|saved| saved.durable));
    let map = SavedMap::at(Path::new(&inside).join("map").as_path());
    let found = wait_for("a whole map", || map.check().ok().filter(|found| found.poses > before + 60));
    println!("saved once there was room: {found:?}");
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

/// Maps of formats and builds that are or were in use, by name: each stays readable. A build that writes another format adds its own
/// beside them (`flockslam up` with a map directory, a drive of a few seconds). The first has no records of a flock, the second has; the submaps
/// of both are of version 2, those of the third of version 3.
const GOLDEN: [(&str, u64, u64, u32); 3] =
    [("map-1", 60, 28, 3), ("map-2", 120, 57, 3), ("map-3", 60, 28, 2)];

#[test]
fn maps_of_all_formats_so_far_are_read() {
    let golden = support::repository().join("tests/golden");
    assert_eq!(fs::read_dir(&golden).unwrap().count(), GOLDEN.len(), "each map that is kept is read");
    for (name, poses, accepted, submaps) in GOLDEN {
        let directory = golden.join(name);
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

#[test]
fn maps_of_all_formats_so_far_are_continued() {
    machine_share::mostly_waits();
    for (name, poses, _, submaps) in GOLDEN {
        let directory = tempfile::tempdir().unwrap();
        let map = directory.path().join("map");
        copy_all(&support::repository().join("tests/golden").join(name), &map);
        let drive = Drive { duration_s: 20.0, ..DRIVE };
        let report = LiveSet::start(name, directory.path(), drive, &keeps(&map)).finish().report;
        let both = SavedMap::at(&map).check().unwrap();
        println!("{name}: {both:?}, {} trajectories", report.trajectories);
        assert!(both.problems.is_empty() && both.submaps > submaps, "{name}: {both:?}");
        assert!(both.poses >= poses + drive.scans() as u64 * 9 / 10, "{name}: {both:?}");
        assert_eq!(both.poses, report.scans, "{name}");
        assert!(report.trajectories >= 2, "{name}: the robot begins somewhere in a map that it knows");
    }
}

fn copy_all(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let (source, copy) = (entry.path(), to.join(entry.file_name()));
        if source.is_dir() {
            copy_all(&source, &copy);
        } else {
            fs::copy(&source, &copy).unwrap();
        }
    }
}
