//! Each check of the fault suite fails when the protection that it looks after is taken away, or what it reads is damaged.

use crate::support::faults::{Trial, descriptors, left_behind, too_much_is_left, with_failpoint};
use crate::support::machine_share;
use crate::support::{Drive, LiveSet};
use flockslam_messages::Stage;

fn complains(trial: &Trial, of: &str) {
    let complaints = trial.complaints();
    println!("{}: {complaints:#?}", trial.fault);
    assert!(
        complaints.iter().any(|complaint| complaint.contains(of)),
        "no word of \"{of}\": {complaints:#?}"
    );
}

#[test]
fn a_set_as_it_is_gives_no_reason_to_complain() {
    machine_share::mostly_waits();
    let trial = with_failpoint("nothing", &[Stage::Mapper], &[]);
    assert!(trial.complaints().is_empty(), "{:#?}", trial.complaints());
}

#[test]
fn a_mapper_that_does_not_replay_the_journal_loses_accepted_scans() {
    machine_share::mostly_waits();
    complains(&with_failpoint("no-replay", &[Stage::Mapper], &[]), "accepted scans are not in the map");
}

#[test]
fn a_mapper_that_replays_what_it_has_in_store_has_scans_twice() {
    machine_share::mostly_waits();
    complains(&with_failpoint("replay-twice", &[Stage::Mapper], &[]), "scans are in the map twice");
}

#[test]
fn a_restarted_matcher_without_its_state_has_lost_its_pose() {
    machine_share::mostly_waits();
    // Without odometry that would tell it. Also a jump is seen, unless poses are missing for so long that a robot could have driven there.
    let trial = with_failpoint("no-resume", &[Stage::ScanMatcher], &["lidar_ingest.odometry=false"]);
    complains(&trial, "the error is");
}

#[test]
fn a_source_and_a_matcher_that_lose_where_they_were_repeat_scans() {
    machine_share::mostly_waits();
    let trial = with_failpoint("no-resume,no-cursor", &[Stage::ScanMatcher, Stage::LidarIngest], &[]);
    complains(&trial, "comes after scan");
    complains(&trial, "lidar-ingest was restarted with scan-matcher");
}

#[test]
fn litter_in_shared_memory_is_noticed() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let drive = Drive { scan_rate_hz: 20.0, duration_s: 600.0, rate: 1.0 };
    let mut set = LiveSet::start("litter", directory.path(), drive, "");
    set.wait_until_handled(Stage::Mapper, 1);
    let (objects, files) = (left_behind(set.robot()), descriptors(set.supervisor_pid()));
    assert_eq!(too_much_is_left(&set, objects, files), None);
    let status_dir = set.runtime_dir().join("status");
    for i in 0..200 {
        std::fs::write(status_dir.join(format!("{i}.litter")), b"").unwrap();
    }
    assert!(too_much_is_left(&set, objects, files).is_some());
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}
