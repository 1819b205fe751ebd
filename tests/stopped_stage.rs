//! Back-pressure of exact replay: with any stage stopped the source comes to rest within its credit window, and the
//! run goes on to the same result when the stage goes on.

use crate::support;
use crate::support::{RunningSet, building, run_well, wait_for};
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

const DURATION_S: u32 = 400;
const SCANS: u64 = 4000;
const WINDOW: u64 = 64;
/// A source that publishes nothing for so long has come to rest: it is some hundred times the time between two scans.
const REST: Duration = Duration::from_millis(300);

fn undisturbed_hash() -> &'static str {
    static HASH: OnceLock<String> = OnceLock::new();
    HASH.get_or_init(|| {
        let directory = tempfile::tempdir().unwrap();
        run_well("calm", directory.path(), &building(DURATION_S)).report.map_hash
    })
}

/// Waits until a stage that is alive has handled nothing new for a while; how much it has handled.
fn handled_at_rest(set: &RunningSet, stage: Stage) -> u64 {
    let (mut last, mut since) = (None, Instant::now());
    wait_for("a source at rest", || {
        let handled = set.handled(stage);
        if handled != last {
            (last, since) = (handled, Instant::now());
        }
        last.filter(|_| since.elapsed() > REST)
    })
}

fn is_stopped(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    // The state follows the name, which is in brackets.
    stat.rsplit(')').next().unwrap().trim_start().starts_with('T')
}

fn stop_and_go_on(stage: Stage) {
    // The source cannot say how far it is while it is stopped itself; its first reader can.
    let observed = if stage == Stage::LidarIngest { Stage::CorrelationFilter } else { Stage::LidarIngest };
    let directory = tempfile::tempdir().unwrap();
    let mut set = RunningSet::start("stopped", directory.path(), &building(DURATION_S));
    let pid = set.pid(stage);
    set.wait_until_handled(observed, 100);
    support::send(pid, Signal::STOP);
    wait_for("the stop", || is_stopped(pid).then_some(()));
    let when_stopped = set.handled(observed).unwrap();
    let at_rest = handled_at_rest(&set, observed);
    println!("{} stopped at {when_stopped}: at rest at {at_rest} of {SCANS} scans", stage.name());
    assert!(at_rest < SCANS, "the run ended without {}", stage.name());
    assert!(at_rest - when_stopped <= WINDOW, "{} scans went on", at_rest - when_stopped);
    support::send(pid, Signal::CONT);
    let outputs = set.finish();
    assert_eq!(outputs.report.scans, SCANS);
    assert_eq!(outputs.report.map_hash, undisturbed_hash());
}

#[test]
fn a_lidar_ingest_that_is_stopped_holds_the_source_back_and_changes_no_result() {
    stop_and_go_on(Stage::LidarIngest);
}

#[test]
fn a_correlation_filter_that_is_stopped_holds_the_source_back_and_changes_no_result() {
    stop_and_go_on(Stage::CorrelationFilter);
}

#[test]
fn a_scan_matcher_that_is_stopped_holds_the_source_back_and_changes_no_result() {
    stop_and_go_on(Stage::ScanMatcher);
}

#[test]
fn a_mapper_that_is_stopped_holds_the_source_back_and_changes_no_result() {
    stop_and_go_on(Stage::Mapper);
}

#[test]
fn a_dynamic_cleaner_that_is_stopped_holds_the_source_back_and_changes_no_result() {
    stop_and_go_on(Stage::DynamicCleaner);
}

#[test]
fn a_sync_manager_that_is_stopped_holds_the_source_back_and_changes_no_result() {
    stop_and_go_on(Stage::SyncManager);
}
