//! What operators see of a running set: its log lines, whose levels change while it runs, and `flockslam top`.

use crate::support;
use crate::support::machine_share;
use crate::support::{Drive, LiveSet, send, stderr, stdout, wait_for};
use flockslam::supervisor::set_metrics_socket;
use flockslam::top::TopState;
use flockslam_messages::Stage;
use flockslam_telemetry::scrape;
use rustix::process::Signal;
use serde_json::Value;
use std::time::{Duration, Instant};

const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 2000.0, rate: 5.0 };

/// The lines of the set's stream.
fn lines(set: &LiveSet) -> Vec<Value> {
    let printed = stdout(&set.command_well(&["log", "--json"]));
    printed.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn poses_in(lines: &[Value]) -> Vec<u64> {
    let of_matcher = |line: &&Value| line["stage"] == "scan-matcher" && line["message"] == "pose";
    lines.iter().filter(of_matcher).map(|line| line["scan"].as_u64().unwrap()).collect()
}

#[test]
fn levels_change_while_a_set_runs_and_lines_name_their_stage_and_scan() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("levels", directory.path(), DRIVE, "");
    set.wait_until_handled(Stage::ScanMatcher, 20);
    assert!(poses_in(&lines(&set)).is_empty());
    set.command_well(&["log", "scan-matcher=debug"]);
    let scans = wait_for("lines with scan numbers", || {
        let scans = poses_in(&lines(&set));
        (scans.len() > 20).then_some(scans)
    });
    assert!(scans.is_sorted());
    assert!(lines(&set).iter().all(|line| line["level"] != "DEBUG" || line["stage"] == "scan-matcher"));
    let shown = stdout(&set.command_well(&["log"]));
    assert!(
        shown.lines().any(|line| line.contains(" DEBUG scan-matcher       pose ") && line.contains(" scan=")),
        "{shown}"
    );
    // What was asked for holds for the next process too.
    let killed = set.pid(Stage::ScanMatcher);
    send(killed, Signal::KILL);
    let last = *scans.last().unwrap();
    wait_for("lines of its successor", || {
        let status = set.status()?;
        let successor = support::of(&status, Stage::ScanMatcher);
        let works = successor.pid.is_some_and(|pid| pid != killed) && successor.handled > 20;
        (works && poses_in(&lines(&set)).last() > Some(&(last + 20))).then_some(())
    });
    set.command_well(&["log", "scan-matcher="]);
    wait_for("silence", || {
        let before = lines(&set).len();
        let status = set.status()?;
        set.wait_until_handled(Stage::ScanMatcher, support::of(&status, Stage::ScanMatcher).handled + 20);
        (lines(&set).len() == before).then_some(())
    });
    for wrong in ["matcher=debug", "scan-matcher=x=y=z", "debug"] {
        let refused = set.command(&["log", wrong]);
        assert_eq!(refused.status.code(), Some(2), "{wrong}: {}", stderr(&refused));
    }
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn top_sees_rates_latencies_and_restarts_of_a_running_set() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("top", directory.path(), DRIVE, "");
    set.wait_until_handled(Stage::SyncManager, 20);
    let socket = set_metrics_socket(&set.runtime_dir());
    let (mut state, started) = (TopState::new(set.robot()), Instant::now());
    let look = |state: &mut TopState| {
        let page = scrape(&socket, Duration::from_secs(2)).ok();
        state.look(started.elapsed().as_secs_f64(), page.as_deref());
    };
    look(&mut state);
    set.wait_until_handled(Stage::SyncManager, 60);
    look(&mut state);
    assert!(state.answers && state.stages.len() == Stage::ALL.len());
    for stage in &state.stages {
        assert!(stage.up && stage.cpu > 0.0 && stage.memory_bytes > 0.0, "{stage:?}");
    }
    let matcher = state.stages.iter().find(|stage| stage.name == "scan-matcher").unwrap();
    assert!(
        matcher.rate_hz > 0.0 && matcher.latency_s.is_some_and(|(median, _)| median > 0.0),
        "{matcher:?}"
    );
    assert!(state.figures.qualities[0] > 0.0 && state.figures.score.is_some_and(|score| score > 0.3));
    send(set.pid(Stage::Mapper), Signal::KILL);
    wait_for("the restart", || {
        look(&mut state);
        state
            .stages
            .iter()
            .find(|stage| stage.name == "mapper" && stage.restarts == 1.0 && stage.up)
            .map(|_| ())
    });
    let refused = set.command(&["top"]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("terminal"));
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}
