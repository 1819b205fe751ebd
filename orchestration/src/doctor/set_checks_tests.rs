//! Each fault of a set is one finding; a set that is well has none.

use super::super::finding::{Finding, Severity};
use super::super::machine_readings::{Machine, MemoryReading, PortReading};
use super::super::set_under_examination::{LidarRate, LogProblem, RunningReading, SetReading};
use super::check_set;
use crate::supervisor::{SaveStatus, SetStatus, StageState, StageStatus};
use flockslam_lidar_ingest::process::LidarLineStatus;
use flockslam_results::{FlockStatus, LocalisationStatus, Unattached};
use std::collections::BTreeMap;
use std::path::PathBuf;

fn machine() -> Machine {
    let shared_memory = Some(MemoryReading { total_bytes: 64 << 20, free_bytes: 60 << 20 });
    Machine {
        version: "1.0.0".to_owned(),
        shared_memory,
        receive_buffer_bytes: Some(212_992),
        ..Machine::default()
    }
}

fn status() -> SetStatus {
    let stage = StageStatus {
        stage: "mapper".to_owned(),
        replica: 0,
        pid: Some(7),
        state: StageState::Running,
        restarts: 0,
        hangs: 0,
        handled: 100,
        silent_s: Some(0.1),
    };
    let saved =
        SaveStatus { directory: "/maps/r1".to_owned(), durable: true, age_s: Some(1.0), problem: None };
    SetStatus { saved: Some(saved), ..SetStatus::of_stages(vec![stage]) }
}

fn running() -> RunningReading {
    let rate = LidarRate { lidar: "front".to_owned(), scans_hz: 10.0, turns_hz: Some(10.2) };
    RunningReading {
        version: Some("1.0.0".to_owned()),
        status: Some(status()),
        lidar_rates: vec![rate],
        handled_hz: 10.0,
        ..RunningReading::default()
    }
}

fn good() -> SetReading {
    SetReading {
        robot: "r1".to_owned(),
        needs_bytes: Some(20 << 20),
        lidars: 1,
        mounted: 1,
        running: Some(running()),
        ..SetReading::default()
    }
}

/// A set that runs, with a fault.
fn runs(change: impl FnOnce(&mut RunningReading)) -> SetReading {
    let mut running = running();
    change(&mut running);
    SetReading { running: Some(running), ..good() }
}

/// The same with a fault that its supervisor says.
fn says(change: impl FnOnce(&mut SetStatus)) -> SetReading {
    runs(|running| change(running.status.as_mut().unwrap()))
}

fn only(set: &SetReading, machine: &Machine) -> Finding {
    let found = check_set(set, machine);
    let [finding] = found.as_slice() else { panic!("{found:?}") };
    finding.clone()
}

fn assert_found(set: &SetReading, severity: Severity, what: &str, cure: &str) {
    let finding = only(set, &machine());
    assert_eq!(finding.severity, severity, "{finding}");
    assert!(finding.what.contains(what) && finding.cure.contains(cure), "{finding}");
}

#[test]
fn of_a_set_that_is_well_nothing_is_found() {
    assert_eq!(check_set(&good(), &machine()), []);
}

#[test]
fn faults_of_a_description_are_found() {
    use Severity::{Error, Info, Warning};
    assert_found(
        &SetReading { refused: Some("set.toml:3: x".to_owned()), ..good() },
        Error,
        "set.toml:3",
        "",
    );
    let absent = vec![PathBuf::from("/nowhere/lidar")];
    assert_found(
        &SetReading { lacking_ports: absent, ..good() },
        Error,
        "/nowhere/lidar is not",
        "lidar list",
    );
    assert_found(&SetReading { lidars: 2, ..good() }, Info, "1 of 2 lidars", "calibrate");
    assert_found(&SetReading { uses_dds: true, ..good() }, Warning, "208 kB", "rmem_default=4194304");
    let endpoint = |problem: Option<&str>| vec![("tcp/r2:7447".to_owned(), problem.map(str::to_owned))];
    let deaf = SetReading { flock_endpoints: endpoint(Some("refused")), ..good() };
    assert_found(&deaf, Warning, "tcp/r2:7447 does not answer: refused", "listen");
    assert_eq!(check_set(&SetReading { flock_endpoints: endpoint(None), ..good() }, &machine()), []);
    let map = Some(PathBuf::from("/maps/x"));
    assert_found(&SetReading { lacks_known_map: map, ..good() }, Error, "/maps/x", "saved map");
    let page = Some("127.0.0.1:8470".to_owned());
    assert_found(&SetReading { page_taken: page, ..good() }, Warning, "127.0.0.1:8470", "page.listen");
    assert_found(&SetReading { running: None, ..good() }, Info, "r1 does not run", "flockslam up");
    let large = SetReading { running: None, needs_bytes: Some(100 << 20), ..good() };
    let found = check_set(&large, &machine());
    assert!(found[0].severity == Error && found[0].what.contains("needs 100 MB"), "{found:?}");
}

#[test]
fn a_port_that_may_change_its_name_is_mentioned_where_there_are_several() {
    let port = || PortReading { usb: Some("CP2102".to_owned()), is_allowed: true, ..PortReading::default() };
    let set = SetReading { lidar_ports: vec![PathBuf::from("/dev/ttyUSB7777")], ..good() };
    let two = Machine { ports: vec![port(), port()], ..machine() };
    let one = Machine { ports: vec![port()], ..machine() };
    assert_eq!(check_set(&set, &one), []);
    assert!(check_set(&set, &two).iter().any(|finding| finding.cure.contains("by-id")));
}

#[test]
fn faults_of_a_set_that_runs_are_found() {
    use Severity::{Error, Info, Warning};
    assert_found(&runs(|set| set.version = Some("0.9.0".to_owned())), Warning, "flockslam 0.9.0", "start it");
    assert_found(&runs(|set| set.status = None), Error, "does not answer", "flockslam log");
    assert_found(&says(|set| set.stages[0].state = StageState::Degraded), Error, "mapper", "flockslam log");
    assert_found(&says(|set| set.stages[0].restarts = 3), Warning, "replaced 3 times", "--bundle");
    assert_found(&says(|set| set.paused = true), Warning, "paused", "resume");
    assert_found(&runs(|set| set.silent.push("rear".to_owned())), Error, "'rear'", "wiring");
    let line = LidarLineStatus { problem: Some("says nothing".to_owned()), ..LidarLineStatus::default() };
    assert_found(&says(|set| set.lidar_lines.push(line)), Error, "says nothing", "lidars.md");
    assert_found(&says(|set| set.saved = None), Warning, "kept nowhere", "--map");
    assert_found(&says(|set| set.not_durable = Some("disk full".to_owned())), Error, "disk full", "room");
    let away = Unattached { scans: 10, travel_m: 3.0, since_s: 1.0 };
    assert_found(&says(|set| set.unattached = Some(away)), Info, "10 scans", "drive");
    let belief = LocalisationStatus { knowledge: "unknown".to_owned(), ..LocalisationStatus::default() };
    assert_found(&says(|set| set.localisation = Some(belief)), Warning, "is unknown", "relocalize");
    let flock =
        |problem: Option<&str>| FlockStatus { problem: problem.map(str::to_owned), ..FlockStatus::default() };
    assert_found(&says(|set| set.flock = Some(flock(None))), Warning, "no other robot", "connect");
    assert_found(&says(|set| set.flock = Some(flock(Some("in use")))), Error, "in use", "addresses");
}

#[test]
fn rates_that_are_too_low_drops_and_lines_of_the_log_are_found() {
    let warning = Severity::Warning;
    let slow_lidar = runs(|set| (set.lidar_rates[0].scans_hz, set.handled_hz) = (5.0, 5.0));
    assert_found(&slow_lidar, warning, "5.0 scans a second of 10.2 turns", "lidars.md");
    assert_found(&runs(|set| set.handled_hz = 4.0), warning, "4.0 poses a second of 10.0", "governor");
    let dropped =
        |count: f64| BTreeMap::from([("overload".to_owned(), count), ("correlated".to_owned(), 90.0)]);
    assert_found(
        &runs(|set| set.dropped = dropped(2.0)),
        warning,
        "2 scans were dropped as `overload`",
        "less",
    );
    assert_eq!(check_set(&runs(|set| set.dropped = dropped(1.0)), &machine()), []);
    let line = LogProblem { stage: "mapper".to_owned(), message: "no transform".to_owned(), times: 4 };
    assert_found(&runs(|set| set.problems.push(line)), warning, "4× mapper: no transform", "errors.md");
}
