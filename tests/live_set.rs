//! A live set: it takes orders, replaces what hangs, goes on without what does not get up, and outlives its supervisor.

use crate::support;
use crate::support::machine_share;
use crate::support::{Drive, LiveSet, PoseWatch, of, send, truth_error_m, truth_offsets_m, wait_for};
use flockslam::store::SavedMap;
use flockslam::supervisor::{SetState, StageState};
use flockslam_bus::RuntimeDir;
use flockslam_messages::Stage;
use flockslam_results::read_live_poses;
use rustix::process::Signal;
use std::time::{Duration, Instant};

/// A drive that no test sees the end of.
const LONG: Drive = Drive { scan_rate_hz: 20.0, duration_s: 600.0, rate: 1.0 };
/// After the order `down` a set has saved its map and all its processes have ended within this.
const DOWN_WITHIN: Duration = Duration::from_secs(2);
/// Other work on the machine makes an end take longer: there is another try, with a fresh set.
const DOWN_TRIES: usize = 3;

fn pids(status: &flockslam::supervisor::SetStatus) -> Vec<(String, Option<u32>)> {
    status.stages.iter().map(|stage| (stage.stage.clone(), stage.pid)).collect()
}

#[test]
fn orders_are_carried_out_and_wrong_ones_refused() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("orders", directory.path(), LONG, "");
    let before = set.wait_until_handled(Stage::Mapper, 3);
    assert!(before.stages.iter().all(|stage| stage.state == StageState::Running), "{before}");
    set.command_well(&["restart", "mapper"]);
    let mapper = of(&before, Stage::Mapper).pid;
    let after = set.wait_until("a new mapper", |status| {
        let stage = of(status, Stage::Mapper);
        stage.state == StageState::Running && stage.pid != mapper
    });
    let others = |status| pids(status).into_iter().filter(|(stage, _)| stage != "mapper").collect::<Vec<_>>();
    assert_eq!(others(&before), others(&after), "no other stage is restarted");
    let wrong = set.command(&["restart", "maper"]);
    assert_eq!(wrong.status.code(), Some(2));
    let too_many = set.command(&["scale", "sync-manager=5"]);
    assert_eq!((too_many.status.code(), support::stderr(&too_many).lines().count()), (Some(2), 1));
    set.command_well(&["pause"]);
    set.wait_until("a pause", |status| status.paused);
    set.command_well(&["resume"]);
    set.wait_until("an end of the pause", |status| !status.paused);
    let json = set.command_well(&["status", "--json"]).stdout;
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    assert_eq!(json["state"], "running");
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

/// How long a driving set takes from the order `down` to the end of its last process. Its map is saved by then.
fn down_after() -> Duration {
    let directory = tempfile::tempdir().unwrap();
    let map = directory.path().join("map");
    let mut set = LiveSet::start("down", directory.path(), LONG, &format!("map = {map:?}"));
    let handled = of(&set.wait_until_handled(Stage::ScanMatcher, 40), Stage::ScanMatcher).handled;
    let ordered = Instant::now();
    set.command_well(&["down"]);
    // The supervisor is the last process of a set: `wait` checks that no other is left.
    assert_eq!(set.wait(), Some(0));
    let took = ordered.elapsed();
    let saved = SavedMap::at(&map).check().unwrap();
    assert!(saved.problems.is_empty() && saved.poses >= handled, "{saved:?}");
    took
}

#[test]
fn within_two_seconds_of_the_order_a_set_has_saved_its_map_and_ended() {
    machine_share::mostly_waits();
    let mut tries: Vec<Duration> = Vec::new();
    while tries.len() < DOWN_TRIES && tries.iter().all(|took| *took > DOWN_WITHIN) {
        tries.push(down_after());
    }
    println!("down after {tries:.2?}");
    assert!(tries.iter().any(|took| *took <= DOWN_WITHIN), "{tries:.2?}");
}

#[test]
fn a_second_set_of_the_same_name_and_a_missing_set_are_refused() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("twice", directory.path(), LONG, "");
    set.pid(Stage::Mapper);
    let second = support::flockslam().arg("up").arg(directory.path().join("set.toml")).output().unwrap();
    assert_eq!(second.status.code(), Some(2), "{}", support::stderr(&second));
    assert!(support::stderr(&second).contains("already running"));
    let nobody = support::flockslam().args(["status", "--robot", "nobody"]).output().unwrap();
    assert_eq!(nobody.status.code(), Some(2));
    send(set.supervisor_pid(), Signal::TERM);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn a_process_gets_the_limits_that_its_stage_is_given() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let more = "stages.dynamic-cleaner = { nice = 7, cpus = [0], memory_max_bytes = 300_000_000 }";
    let mut set = LiveSet::start("limits", directory.path(), LONG, more);
    set.wait_until_handled(Stage::DynamicCleaner, 1);
    let pid = set.pid(Stage::DynamicCleaner);
    let read_of = |pid: u32, name: &str| std::fs::read_to_string(format!("/proc/{pid}/{name}")).unwrap();
    let read = |name: &str| read_of(pid, name);
    let limits = read("limits");
    let data = limits.lines().find(|line| line.starts_with("Max data size")).unwrap();
    assert!(data.contains("300000000"), "{data}");
    assert!(read("status").lines().any(|line| line == "Cpus_allowed_list:\t0"));
    // Behind the name, which is in brackets, the niceness is the 17th field.
    let niceness = |pid: u32| {
        let stat = read_of(pid, "stat");
        stat.rsplit(')').next().unwrap().split_whitespace().nth(16).unwrap().parse::<i32>().unwrap()
    };
    assert_eq!(niceness(pid), 7 + niceness(set.supervisor_pid()));
}

#[test]
fn the_filter_gets_a_second_process_and_loses_it_again_without_a_lost_scan() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("scale", directory.path(), LONG, "");
    let before = set.wait_until_handled(Stage::ScanMatcher, 20);
    let poses = PoseWatch::start(&set.runtime_dir());
    for processes in [2, 1] {
        set.command_well(&["scale", &format!("correlation-filter={processes}")]);
        let status = set.wait_until("the filter to run", |status| {
            let filters = status.stages.iter().filter(|stage| stage.stage == "correlation-filter");
            filters.clone().count() == processes && filters.clone().all(|f| f.state == StageState::Running)
        });
        let seen = poses.count();
        wait_for("more poses", || (poses.count() > seen + 10).then_some(()));
        let others = |status| {
            pids(status).into_iter().filter(|(stage, _)| stage != "correlation-filter").collect::<Vec<_>>()
        };
        assert_eq!(others(&before), others(&status));
    }
    let sequences: Vec<_> = poses.seen().iter().map(|seen| seen.pose.id.sequence).collect();
    assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1), "every scan has a pose: {sequences:?}");
}

/// A stage that is stopped is counted as a hang and replaced, no other stage is restarted, and poses go on.
fn a_stopped_stage_is_replaced(stage: Stage) {
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("hang", directory.path(), LONG, "");
    set.wait_until_handled(stage, 2);
    let poses = PoseWatch::start(&set.runtime_dir());
    let stopped = set.pid(stage);
    let since = Instant::now();
    send(stopped, Signal::STOP);
    let status = set.wait_until("a successor", |status| {
        let found = of(status, stage);
        found.state == StageState::Running && found.pid != Some(stopped)
    });
    let replaced_s = since.elapsed().as_secs_f64();
    let found = of(&status, stage);
    assert_eq!((found.hangs, found.restarts), (1, 1));
    for other in status.stages.iter().filter(|other| other.stage != stage.name()) {
        assert_eq!(other.restarts, 0, "{status}");
    }
    let back_ms = poses.back_after_ms(since);
    println!("{} stopped: replaced after {replaced_s:.2} s, poses back after {back_ms:.0} ms", stage.name());
}

#[test]
fn a_stopped_source_is_replaced() {
    machine_share::mostly_waits();
    a_stopped_stage_is_replaced(Stage::LidarIngest);
}

#[test]
fn a_stopped_matcher_is_replaced() {
    machine_share::mostly_waits();
    a_stopped_stage_is_replaced(Stage::ScanMatcher);
}

#[test]
fn a_stopped_mapper_is_replaced() {
    machine_share::mostly_waits();
    a_stopped_stage_is_replaced(Stage::Mapper);
}

#[test]
fn without_a_matcher_odometry_is_followed_until_it_gets_up() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut set = LiveSet::start("degraded", directory.path(), LONG, "retry_s = 2.0");
    set.wait_until_handled(Stage::ScanMatcher, 5);
    // Dead on sight, whenever it is started: but for the first one, none lives to handle a scan.
    let mut killed = None;
    let status = wait_for("the stage to be given up", || {
        let status = set.status()?;
        let matcher = of(&status, Stage::ScanMatcher);
        if matcher.state != StageState::Degraded && matcher.pid.is_some() && matcher.pid != killed {
            killed = matcher.pid;
            send(killed.unwrap(), Signal::KILL);
        }
        (status.state == SetState::Degraded).then_some(status)
    });
    println!("{status}");
    assert!(of(&status, Stage::ScanMatcher).restarts >= 4);
    let poses = PoseWatch::start(&set.runtime_dir());
    let degraded = wait_for("poses by the wheels", || poses.seen().first().map(|seen| seen.pose));
    assert!(!degraded.has(flockslam_messages::PoseFlags::MATCHED));
    assert_eq!(degraded.quality, flockslam_messages::Quality::Degraded as u32);
    set.wait_until("the matcher to get up again", |status| status.state == SetState::Running);
    wait_for("matched poses", || {
        poses.seen().iter().any(|seen| seen.pose.has(flockslam_messages::PoseFlags::MATCHED)).then_some(())
    });
}

#[test]
fn a_set_whose_supervisor_was_killed_continues_from_its_stored_state() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = Drive { scan_rate_hz: 20.0, duration_s: 40.0, rate: 2.0 };
    let mut set = LiveSet::start("heir", directory.path(), drive, "");
    set.wait_until_handled(Stage::ScanMatcher, 200);
    let since = Instant::now();
    let mut set = set.kill_and_start_again();
    set.wait_until_handled(Stage::ScanMatcher, 1);
    println!("mapping again {:.2} s after SIGKILL of the supervisor", since.elapsed().as_secs_f64());
    let outputs = set.finish();
    let (lines, error_m) = (outputs.lines("trajectory.tum").len(), truth_error_m(&outputs));
    println!("{lines} of {} scans, {error_m:.3} m against the truth", drive.scans());
    // It maps again after .24 s, with eight busy loops beside it after 5.7 s. What overflows a queue meanwhile has no pose.
    assert!(lines * 100 >= drive.scans() * 75 && error_m < 0.3, "{lines} poses, {error_m} m");
    assert_eq!(outputs.report.trajectories, 1, "the robot is where it was");
    assert!(since.elapsed() < Duration::from_secs(90));
}

/// The active submap of a mapper is empty until the next accepted scan: its successor has closed ones alone to give a grid from.
#[test]
fn a_set_that_is_killed_as_a_submap_closes_matches_on_the_same_grid_again() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = Drive { scan_rate_hz: 20.0, duration_s: 30.0, rate: 1.0 };
    let arguments = ["--set".to_owned(), "mapper.submap_insertions=20".to_owned()];
    let mut set = LiveSet::start_with_failpoints("closing", directory.path(), drive, "", &arguments, "");
    set.wait_until_handled(Stage::ScanMatcher, 1);
    let poses = PoseWatch::start(&set.runtime_dir());
    wait_for("a closed submap", || poses.last().filter(|last| last.pose.submap > 0).map(drop));
    let inserted = poses.inserted();
    drop(poses);
    let set = set.kill_and_start_again();
    let outputs = set.finish();
    let report = &outputs.report;
    println!(
        "{inserted} scans had entered the map; {} submaps, {:.3} m",
        report.submaps,
        truth_error_m(&outputs)
    );
    assert!(report.submaps > 2, "{} submaps: no scan has entered the map since", report.submaps);
    assert!(truth_error_m(&outputs) < 0.05);
}

/// A mapper that is killed between storing and sending, or that sends before sync-manager is there, leaves such a gap.
#[test]
fn submaps_are_concluded_though_the_notice_of_one_is_lost() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = Drive { scan_rate_hz: 20.0, duration_s: 1300.0, rate: 2.0 };
    let arguments = ["--set".to_owned(), "mapper.submap_insertions=20".to_owned()];
    let failpoint = "lost-notice";
    let mut set =
        LiveSet::start_with_failpoints("notice", directory.path(), drive, "", &arguments, failpoint);
    set.wait_until_handled(Stage::SyncManager, 1);
    let results = RuntimeDir::open(&set.runtime_dir()).unwrap().results();
    let concluded = || read_live_poses(&results).map_or(0, |solution| solution.submaps.len());
    wait_for("a submap behind the lost notice", || (concluded() > 2).then_some(()));
    send(set.supervisor_pid(), Signal::TERM);
    assert_eq!(set.wait(), Some(0));
}

/// A connection in shared memory that could not be made stays away without an error.
#[test]
fn a_sync_manager_that_no_pose_reaches_is_replaced_and_loses_none() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = Drive { scan_rate_hz: 20.0, duration_s: 60.0, rate: 2.0 };
    let mut set = LiveSet::start_with_failpoints("deaf", directory.path(), drive, "", &[], "deaf");
    // The first process handles none.
    set.wait_until_handled(Stage::SyncManager, 100);
    let outputs = set.finish();
    let lines = outputs.lines("trajectory.tum").len();
    println!("{lines} of {} scans", drive.scans());
    assert!(lines * 100 >= drive.scans() * 98, "{lines} poses");
}

/// While sync-manager is held up, more poses wait for it than scans.
#[test]
fn scans_that_have_left_the_queue_before_their_turn_are_placed_from_the_journal() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = Drive { scan_rate_hz: 10.0, duration_s: 80.0, rate: 4.0 };
    // There the robot turns, and without its scans its poses follow odometry.
    let seed = ["--set", "simulation.seed=2"].map(str::to_owned);
    let mut set = LiveSet::start_with_failpoints("held-up", directory.path(), drive, "", &seed, "");
    let before = of(&set.wait_until_handled(Stage::SyncManager, 340), Stage::ScanMatcher).handled;
    let held_up = set.pid(Stage::SyncManager);
    send(held_up, Signal::STOP);
    set.wait_until_handled(Stage::ScanMatcher, before + 110);
    send(held_up, Signal::CONT);
    let outputs = set.finish();
    let worst_m = truth_offsets_m(&outputs, outputs.frame_from_truth(), 0.0).into_iter().fold(0.0, f64::max);
    println!("{worst_m} m from the truth at most");
    assert_eq!(outputs.report.stages["sync-manager"].restarts, 0);
    assert!(worst_m < 0.1, "{worst_m}");
}
