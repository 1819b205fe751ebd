//! `kill -9` of any process: a live run restarts the stage and ends with a usable map, an exact replay says what died,
//! and a killed supervisor leaves no stage behind.

use crate::support;
use crate::support::machine_share;
use crate::support::{RunningSet, building, live_building, processes_of, run_well, truth_error_m, wait_for};
use flockslam_messages::Stage;
use flockslam_stage::heartbeat_file;
use flockslam_telemetry::read_heartbeat;
use rustix::process::Signal;
use std::process::Stdio;
use std::sync::OnceLock;

const DURATION_S: u32 = 60;
const RATE: u32 = 2;
const SCANS: usize = 600;

fn undisturbed_area_m2() -> f64 {
    static AREA: OnceLock<f64> = OnceLock::new();
    *AREA.get_or_init(|| {
        let directory = tempfile::tempdir().unwrap();
        run_well("calm", directory.path(), &building(DURATION_S)).report.map_area_m2
    })
}

fn kill_during_a_live_replay(stage: Stage) {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = RunningSet::start("killed", directory.path(), &live_building(DURATION_S, RATE));
    set.wait_until_handled(Stage::LidarIngest, SCANS as u64 / 3);
    let killed = set.pid(stage);
    support::send(killed, Signal::KILL);
    let successor = wait_for("a successor", || Some(set.pid(stage)).filter(|pid| *pid != killed));
    let outputs = set.finish();
    for (name, report) in &outputs.report.stages {
        if name == stage.name() {
            assert_eq!((report.pids.as_slice(), report.restarts), ([killed, successor].as_slice(), 1));
        } else {
            assert_eq!((report.pids.len(), report.restarts), (1, 0), "{name} was restarted as well");
        }
    }
    let (lines, error_m) = (outputs.lines("trajectory.tum").len(), truth_error_m(&outputs));
    let share = outputs.report.map_area_m2 / undisturbed_area_m2();
    println!(
        "{} killed: {lines} of {SCANS} scans, {error_m:.3} m against the truth, {:.0} % of the area",
        stage.name(),
        100.0 * share
    );
    // Scans are lost while the successor starts: three seconds of them, on a busy machine.
    assert!(lines * 100 >= SCANS * 90, "{lines} scans");
    assert!(error_m < 0.3, "{error_m} m");
    assert!(share >= 0.8, "{share}");
}

#[test]
fn a_live_run_restarts_a_lidar_ingest_that_is_killed_and_ends_with_a_usable_map() {
    kill_during_a_live_replay(Stage::LidarIngest);
}

#[test]
fn a_live_run_restarts_a_correlation_filter_that_is_killed_and_ends_with_a_usable_map() {
    kill_during_a_live_replay(Stage::CorrelationFilter);
}

#[test]
fn a_live_run_restarts_a_scan_matcher_that_is_killed_and_ends_with_a_usable_map() {
    kill_during_a_live_replay(Stage::ScanMatcher);
}

#[test]
fn a_live_run_restarts_a_mapper_that_is_killed_and_ends_with_a_usable_map() {
    kill_during_a_live_replay(Stage::Mapper);
}

#[test]
fn a_live_run_restarts_a_dynamic_cleaner_that_is_killed_and_ends_with_a_usable_map() {
    kill_during_a_live_replay(Stage::DynamicCleaner);
}

#[test]
fn a_live_run_restarts_a_sync_manager_that_is_killed_and_ends_with_a_usable_map() {
    kill_during_a_live_replay(Stage::SyncManager);
}

/// Kills of one stage in a row, each as soon as its process has met a scan: before that scan was handled or after it, as the
/// machine's load has it.
const STORM: usize = 12;

#[test]
fn a_storm_of_kills_of_one_stage_does_not_end_a_live_run() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = RunningSet::start("storm", directory.path(), &live_building(DURATION_S, 2));
    let file = heartbeat_file(&set.status_dir(), "mapper-0");
    for kill in 1..=STORM {
        let beat = wait_for("a mapper that has met a scan", || {
            let beat = read_heartbeat(&file).ok()??;
            (beat.works && support::try_send(beat.pid, Signal::KILL)).then_some(beat)
        });
        wait_for("its death", || (set.pid(Stage::Mapper) != beat.pid).then_some(()));
        println!("kill {kill}: process {} had handled {}", beat.pid, beat.handled);
    }
    set.wait_until_handled(Stage::SyncManager, 1);
    let outputs = set.finish();
    assert_eq!(outputs.report.stages["mapper"].restarts, STORM as u64);
    let (lines, error_m) = (outputs.lines("trajectory.tum").len(), truth_error_m(&outputs));
    println!("{lines} of {SCANS} scans, {error_m:.3} m, {:.0} m²", outputs.report.map_area_m2);
    assert!(lines * 100 >= SCANS * 95 && error_m < 0.3, "{lines} scans, {error_m} m");
    assert!(outputs.report.map_area_m2 >= 0.8 * undisturbed_area_m2());
}

#[test]
fn an_exact_replay_ends_with_the_name_of_the_dead_stage_and_no_outputs() {
    let directory = tempfile::tempdir().unwrap();
    let mut messages = None;
    let mut set = RunningSet::start_with("exact", directory.path(), &building(400), |command| {
        let (reader, writer) = std::io::pipe().unwrap();
        messages = Some(reader);
        command.stdin(Stdio::null()).stderr(writer);
    });
    set.wait_until_handled(Stage::LidarIngest, 100);
    set.signal(Stage::Mapper, Signal::KILL);
    assert_eq!(set.wait(), Some(1));
    let text = std::io::read_to_string(messages.unwrap()).unwrap();
    assert!(text.contains("mapper ended during an exact replay (signal 9)"), "{text}");
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}

#[test]
fn stages_die_with_their_supervisor_and_the_next_run_sweeps_up() {
    let directory = tempfile::tempdir().unwrap();
    let mut set = RunningSet::start("orphans", directory.path(), &live_building(250, 5));
    set.wait_until_handled(Stage::SyncManager, 1);
    let stages = Stage::ALL.map(|stage| set.pid(stage));
    support::send(set.supervisor_pid(), Signal::KILL);
    wait_for("the death of all stages", || processes_of(set.robot()).is_empty().then_some(()));
    println!("stages {stages:?} died with their supervisor");
    run_well("sweep", directory.path(), &building(10));
    support::assert_nothing_left(set.robot());
}
