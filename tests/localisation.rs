//! A set that localizes: it finds its robot in a map that is known and follows it there. The map is only read.

use crate::support::machine_share;
use crate::support::{
    Drive, LiveSet, Outputs, building, data_dir, flockslam, is_localized, robot, run, run_well, send, stderr,
};
use flockslam::outputs::TrajectoryPoint;
use flockslam_bus::RuntimeDir;
use flockslam_geometry::Pose;
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::fs;
use std::path::Path;

/// A drive that no test sees the end of.
const LONG: Drive = Drive { scan_rate_hz: 10.0, duration_s: 3000.0, rate: 6.0 };

/// Makes a map of the simulated building in this directory.
fn map_in(directory: &Path) -> Outputs {
    let mut args = building(60);
    args.extend(["--set", "correlation_filter.mode=off"].map(str::to_owned));
    run_well("known-map", directory, &args)
}

#[test]
fn a_robot_is_followed_in_a_known_map_which_stays_the_same_to_the_byte() {
    let directory = tempfile::tempdir().unwrap();
    let (known, out) = (directory.path().join("known"), directory.path().join("out"));
    let mapped = map_in(&known);
    let mut args = building(60);
    args.extend(["--localize".to_owned(), known.display().to_string()]);
    let localized = run_well("localizes", &out, &args);
    let found = localized.report.localisation.expect("the report tells of localisation");
    println!("{found:?}");
    assert!(
        found.found_after_m.is_some_and(|way_m| way_m < 5.0) && found.unlocalized_scans < 60,
        "{found:?}"
    );
    assert_eq!(fs::read(known.join("map.pgm")).unwrap(), fs::read(out.join("map.pgm")).unwrap());
    assert_eq!(localized.report.submaps, 0, "no map was made");
    // The same drive: its poses are those of the run that has made the map.
    let (before, after) = (mapped.lines("trajectory.tum"), localized.lines("trajectory.tum"));
    assert_eq!(before.len(), after.len());
    let mut farthest_m = 0.0f64;
    for (a, b) in before.iter().zip(&after) {
        let numbers =
            |line: &str| -> Vec<f64> { line.split(' ').map(|word| word.parse().unwrap()).collect() };
        let (a, b) = (numbers(a), numbers(b));
        farthest_m = farthest_m.max((a[1] - b[1]).hypot(a[2] - b[2]));
    }
    println!("at most {farthest_m:.3} m from where mapping had it");
    assert!(farthest_m < 0.12, "{farthest_m} m");
    let again = directory.path().join("again");
    run_well("localizes", &again, &args);
    let bytes = |out: &Path| fs::read(out.join("trajectory.tum")).unwrap();
    assert_eq!(bytes(&out), bytes(&again), "an exact replay gives the same bytes");
}

#[test]
fn killed_stages_and_orders_leave_the_known_map_as_it_is() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let known = directory.path().join("known");
    map_in(&known);
    let map_bytes = fs::read(known.join("map.pgm")).unwrap();
    let mut set = LiveSet::start("known", directory.path(), LONG, &format!("localize = {known:?}"));
    let status = set.wait_until("the robot is localized", is_localized);
    println!("{}", status.localisation.unwrap());
    let known_in_set = RuntimeDir::open(&set.runtime_dir()).unwrap().results().join("known.map");
    let bytes_in_set = fs::read(&known_in_set).unwrap();
    for stage in [Stage::SyncManager, Stage::ScanMatcher, Stage::Mapper, Stage::SyncManager] {
        let pid = set.pid(stage);
        send(pid, Signal::KILL);
        let handled = set.status().unwrap().localisation.unwrap().stamp_ns;
        set.wait_until("the robot is localized after a kill", |status| {
            is_localized(status) && status.localisation.as_ref().is_some_and(|l| l.stamp_ns > handled)
        });
    }
    // The supervisor and all stages at once; the next set of this name goes on in the same map.
    let mut set = set.kill_and_start_again();
    set.wait_until("the robot is localized by the next set", is_localized);
    let searches = set.status().unwrap().localisation.unwrap().searches;
    set.command_well(&["relocalize"]);
    set.wait_until("the robot is looked for on request", |status| {
        is_localized(status) && status.localisation.as_ref().is_some_and(|l| l.searches > searches)
    });
    let nonsense = set.command(&["relocalize", "--near", "here"]);
    assert_eq!(nonsense.status.code(), Some(2));
    let reset = set.command(&["reset"]);
    assert_eq!(reset.status.code(), Some(2));
    assert!(stderr(&reset).contains("relocalize"), "{}", stderr(&reset));
    assert_eq!(fs::read(&known_in_set).unwrap(), bytes_in_set);
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
    assert_eq!(fs::read(known.join("map.pgm")).unwrap(), map_bytes);
}

#[test]
fn a_saved_map_is_localized_in_and_stays_as_it_is() {
    let directory = tempfile::tempdir().unwrap();
    let saved = directory.path().join("saved");
    let mut first = LiveSet::start("keeps", directory.path(), LONG, &format!("map = {saved:?}"));
    first.wait_until_handled(Stage::ScanMatcher, 300);
    first.command_well(&["down"]);
    assert_eq!(first.wait(), Some(0));
    let bytes = || ["map.head", "scans.journal"].map(|name| fs::read(saved.join(name)).unwrap());
    let before = bytes();
    let mut second = LiveSet::start("reads", directory.path(), LONG, &format!("localize = {saved:?}"));
    second.wait_until("the robot is localized", is_localized);
    second.command_well(&["down"]);
    assert_eq!(second.wait(), Some(0));
    assert!(before == bytes(), "the saved map has changed");
}

#[test]
fn a_robot_that_is_not_in_the_map_is_not_found_there() {
    let directory = tempfile::tempdir().unwrap();
    let (known, out) = (directory.path().join("known"), directory.path().join("out"));
    map_in(&known);
    let mut args = building(60);
    args.extend(["--set".to_owned(), "simulation.world=hotel".to_owned()]);
    args.extend(["--localize".to_owned(), known.display().to_string()]);
    let report = run_well("elsewhere", &out, &args).report;
    let found = report.localisation.unwrap();
    println!("{found:?}");
    assert_eq!((found.localized_scans, found.found), (0, 0));
    assert_eq!(report.detached_scans, report.scans);
}

/// Drives of five and of twenty-five minutes among people and doors: what a robot sees beside the known map does not add up.
#[test]
fn five_times_the_way_in_a_known_map_takes_the_same_memory() {
    let directory = tempfile::tempdir().unwrap();
    let known = directory.path().join("known");
    run_well("known-map", &known, &building(200));
    let peaks = |duration_s: u32| {
        let mut args = building(duration_s);
        let more = ["--set", "simulation.walkers=6", "--set", "simulation.doors=4", "--localize"];
        args.extend(more.map(str::to_owned));
        args.push(known.display().to_string());
        let report = run_well("flat", &directory.path().join(format!("out-{duration_s}")), &args).report;
        let found = report.localisation.unwrap();
        println!("{:.0} m: {found:?}", report.trajectory_length_m);
        assert!(found.unlocalized_scans * 50 < report.scans, "{found:?}");
        report
            .stages
            .into_iter()
            .map(|(stage, report)| (stage, report.peak_private_bytes))
            .collect::<Vec<_>>()
    };
    for ((stage, short), (_, long)) in peaks(200).into_iter().zip(peaks(1000)) {
        println!("{stage}: {:.1} MB, then {:.1} MB", short as f64 / 1e6, long as f64 / 1e6);
        // Poses and views of sync-manager are bounded at ten times the short drive.
        let more = if stage == Stage::SyncManager.name() { 6_000_000 } else { 2_000_000 };
        assert!(long < short + more, "{stage}: {short} bytes, then {long}");
    }
}

#[test]
fn what_is_no_map_to_localize_in_is_refused_in_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let nowhere = directory.path().join("nowhere");
    let mut args = building(5);
    args.extend(["--localize".to_owned(), nowhere.display().to_string()]);
    let output = run("no-map", &directory.path().join("out"), &args);
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(text.lines().count() == 1 && text.contains("no map to localize in"), "{text}");

    let set = directory.path().join("set.toml");
    let name = robot("both");
    fs::write(&set, format!("robot = \"{name}\"\nmap = \"kept\"\nlocalize = \"known\"\n")).unwrap();
    let output = flockslam().arg("up").arg(&set).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(stderr(&output).lines().count(), 1, "{}", stderr(&output));

    let mut mapping = LiveSet::start("maps", directory.path(), LONG, "");
    mapping.wait_until_handled(Stage::ScanMatcher, 5);
    let order = mapping.command(&["relocalize"]);
    assert_eq!(order.status.code(), Some(2));
    assert!(stderr(&order).contains("--localize"), "{}", stderr(&order));
    mapping.command_well(&["down"]);
    assert_eq!(mapping.wait(), Some(0));
}

/// Where the frame of one map is in that of another by a drive that has poses in both: medians.
fn between_maps(in_one: &Outputs, in_other: &Outputs) -> Pose {
    let [one, other] = [in_one, in_other].map(|outputs| outputs.trajectory("trajectory.tum"));
    assert_eq!(one.len(), other.len());
    let placed = |(one, other): (&TrajectoryPoint, &TrajectoryPoint)| {
        one.map_from_base * other.map_from_base.inverse()
    };
    let frames: Vec<Pose> = one.iter().zip(&other).map(placed).collect();
    let median = |of: fn(&Pose) -> f64| {
        let mut numbers: Vec<f64> = frames.iter().map(of).collect();
        numbers.sort_by(f64::total_cmp);
        numbers[numbers.len() / 2]
    };
    Pose::new(median(|pose| pose.x_m), median(|pose| pose.y_m), median(|pose| pose.heading_rad))
}

/// One robot in one floor before and after a kidnapping: each drive is found in the map of the other, and both agree on how the maps lie.
#[test]
fn a_robot_that_was_carried_elsewhere_is_found_in_the_map_of_before_and_the_other_way_round() {
    let Some(data) = data_dir() else { return };
    let directory = tempfile::tempdir().unwrap();
    let recording = |name: &str| data.join("robot/carried").join(name).display().to_string();
    let run_of = |name: &str, more: &[String]| {
        let out = directory.path().join(format!("{name}-{}", more.len()));
        let args = [&["map".to_owned(), recording(name)], more].concat();
        (run_well("carried", &out, &args), out)
    };
    let ((before, map_before), (after, map_after)) = (run_of("before.bag", &[]), run_of("after.bag", &[]));
    let localized_in = |name: &str, map: &Path| {
        let (outputs, _) = run_of(name, &["--localize".to_owned(), map.display().to_string()]);
        println!("{name}: {:?}", outputs.report.localisation);
        assert!(outputs.report.localisation.as_ref().is_some_and(|found| found.localized_scans > 300));
        outputs
    };
    let before_from_after = between_maps(&localized_in("after.bag", &map_before), &after);
    let after_from_before = between_maps(&localized_in("before.bag", &map_after), &before);
    let off = before_from_after * after_from_before;
    println!("{before_from_after:?}, there and back: {off:?}");
    // Reached: 0.015 m and 0.09°.
    assert!(off.position().norm_m() < 0.03 && off.heading_rad.abs() < 0.2f64.to_radians(), "{off:?}");
}
