//! Several processes of a stage: the same bytes in exact replay, and none is missed when they come, go or die in a live set.

use crate::support::faults::Evidence;
use crate::support::machine_share;
use crate::support::{Drive, LiveSet, Outputs, PoseWatch, building, run_well, send, wait_for};
use flockslam::store::SavedMap;
use flockslam::supervisor::{SetStatus, StageState};
use flockslam_messages::Stage;
use flockslam_stage::leader;
use rustix::process::Signal;
use std::path::Path;
use std::time::Instant;

const REPEATED: [&str; 4] = ["trajectory.tum", "trajectory_online.tum", "map.pgm", "map.yaml"];

/// A world in which things move, so that the cleaner has something to clear, replayed with so many processes of some stages.
fn replay(directory: &Path, stages: &[Stage], replicas: usize) -> Outputs {
    let mut args = building(60);
    args.extend(["--set".to_owned(), "simulation.walkers=4".to_owned()]);
    for stage in stages {
        let section = stage.name().replace('-', "_");
        args.extend(["--set".to_owned(), format!("{section}.replicas={replicas}")]);
    }
    run_well("replicas", directory, &args)
}

#[test]
fn exact_replay_gives_the_same_bytes_with_one_two_or_three_processes_of_a_stage() {
    let directory = tempfile::tempdir().unwrap();
    let alone = replay(&directory.path().join("alone"), &[], 1);
    let same = |name: String, outputs: Outputs, stages: &[Stage], replicas: usize| {
        for file in REPEATED {
            assert!(alone.bytes(file) == outputs.bytes(file), "{name}: {file} differs");
        }
        assert_eq!(alone.report.map_hash, outputs.report.map_hash, "{name}");
        for stage in stages {
            assert_eq!(outputs.report.stages[stage.name()].pids.len(), replicas, "{name}");
        }
    };
    for stage in Stage::ALL {
        let outputs = replay(&directory.path().join(stage.name()), &[stage], 2);
        same(format!("two of {}", stage.name()), outputs, &[stage], 2);
    }
    let outputs = replay(&directory.path().join("all"), &Stage::ALL, 3);
    same("three of each stage".to_owned(), outputs, &Stage::ALL, 3);
}

fn processes_of(status: &SetStatus, stage: Stage) -> Vec<(u32, StageState)> {
    let of_stage = status.stages.iter().filter(|found| found.stage == stage.name());
    of_stage.map(|found| (found.pid.unwrap_or(0), found.state)).collect()
}

fn others(status: &SetStatus, stage: Stage) -> Vec<(String, Option<u32>)> {
    let others = status.stages.iter().filter(|found| found.stage != stage.name());
    others.map(|found| (found.stage.clone(), found.pid)).collect()
}

/// A set that drives and keeps its map, and its poses.
struct Subject {
    set: LiveSet,
    poses: PoseWatch,
    map: SavedMap,
}

impl Subject {
    fn start(directory: &Path, more: &str) -> Self {
        let drive = Drive { scan_rate_hz: 20.0, duration_s: 60.0, rate: 2.0 };
        let map = directory.join("map");
        let mut set = LiveSet::start("replica", directory, drive, &format!("map = {map:?}\n{more}"));
        set.wait_until_handled(Stage::Mapper, 1);
        let poses = PoseWatch::start(&set.runtime_dir());
        Self { set, poses, map: SavedMap::at(&map) }
    }

    fn wait_until_all_run(&mut self, stage: Stage, count: usize) -> SetStatus {
        let what = format!("{count} of {} to run", stage.name());
        let status = self.set.wait_until(&what, |status| {
            let processes = processes_of(status, stage);
            processes.len() == count && processes.iter().all(|(_, state)| *state == StageState::Running)
        });
        let seen = self.poses.count();
        wait_for("more poses", || (self.poses.count() > seen + 10).then_some(()));
        status
    }

    /// The drive ends; every scan has a pose but for those that a busy machine made the set drop, and every accepted one is in the
    /// map once.
    fn conclude(self) {
        let Self { set, poses, map } = self;
        let dropped = set.finish().report.dropped;
        let for_haste: u64 = ["overload", "deadline"].iter().filter_map(|reason| dropped.get(*reason)).sum();
        let sequences: Vec<_> = poses.seen().iter().map(|seen| seen.pose.id.sequence).collect();
        let gaps: Vec<_> = sequences.windows(2).filter(|pair| pair[1] != pair[0] + 1).collect();
        let missing: u64 = gaps.iter().map(|pair| pair[1].saturating_sub(pair[0] + 1)).sum();
        assert!(missing <= for_haste, "scans have no pose: {gaps:?}; dropped {dropped:?}");
        let evidence = Evidence::of(&map);
        assert!(evidence.violations().is_empty(), "{:#?}", evidence.violations());
        println!("{} poses, {} accepted scans in the map", evidence.poses.len(), evidence.inserted);
    }
}

#[test]
fn each_stage_gets_a_second_process_and_loses_it_again_without_a_lost_scan() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let mut subject = Subject::start(directory.path(), "");
    for stage in Stage::ALL {
        let before = subject.wait_until_all_run(stage, 1);
        for count in [2, 1] {
            subject.set.command_well(&["scale", &format!("{}={count}", stage.name())]);
            let after = subject.wait_until_all_run(stage, count);
            assert_eq!(
                others(&before, stage),
                others(&after, stage),
                "no other stage is restarted: {:#?}",
                after.stages
            );
        }
    }
    subject.conclude();
}

#[test]
fn a_standby_takes_over_at_the_next_scan_when_the_active_one_is_killed() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let stages = [Stage::ScanMatcher, Stage::SyncManager, Stage::LidarIngest];
    let twice: String =
        stages.iter().map(|stage| format!("stages.{}.replicas = 2\n", stage.name())).collect();
    let mut subject = Subject::start(directory.path(), &twice);
    for stage in stages {
        subject.wait_until_all_run(stage, 2);
        let status_dir = subject.set.runtime_dir().join("status");
        let active = leader(&status_dir, stage.name()).unwrap();
        let since = Instant::now();
        send(active, Signal::KILL);
        let back_ms = subject.poses.back_after_ms(since);
        wait_for("another to act", || leader(&status_dir, stage.name()).filter(|pid| *pid != active));
        println!("{} killed: the next pose after {back_ms:.0} ms", stage.name());
        subject.wait_until_all_run(stage, 2);
    }
    subject.conclude();
}
