//! Faults, in short: each kind a few times, seeded, against real processes. `cargo bench -p flockslam --bench faults` is the long
//! form, which prints a table. The recovery time of a set is printed here and not checked.

use crate::support::faults::{
    Evidence, Trial, corrupt_scans, crashing_starts, endless_loop, everything_at_once, jumping_clock,
    kills_of_each_stage, kills_while_saving, stops_of_each_stage, storm, terminations, torn_files,
};
use crate::support::machine_share;
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, Stage};

fn check(trial: &Trial) {
    println!("{}\n{}", Trial::HEAD, trial.line());
    let complaints = trial.complaints();
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn any_stage_may_be_killed() {
    machine_share::mostly_waits();
    let trial = kills_of_each_stage(&Stage::ALL, 1, 1);
    check(&trial);
    assert_eq!((trial.runs, trial.lost), (Stage::ALL.len(), 0), "each stage is killed and nothing is lost");
}

#[test]
fn a_filter_and_a_cleaner_that_hang_are_replaced() {
    machine_share::mostly_waits();
    let trial = stops_of_each_stage(&[Stage::CorrelationFilter, Stage::DynamicCleaner], 1, 2);
    check(&trial);
    assert_eq!((trial.runs, trial.lost), (2, 0));
}

#[test]
fn an_endless_loop_is_a_hang() {
    machine_share::mostly_waits();
    check(&endless_loop(Stage::Mapper));
}

#[test]
fn the_wall_clock_may_jump_by_hours() {
    machine_share::mostly_waits();
    check(&jumping_clock(10.0));
}

#[test]
fn a_storm_of_kills() {
    machine_share::mostly_waits();
    let trial = storm(8.0, 3);
    check(&trial);
    assert!(trial.runs > 1 && trial.lost == 0, "{} kills, {} accepted scans lost", trial.runs, trial.lost);
}

#[test]
fn all_stages_and_the_supervisor_may_be_killed() {
    machine_share::mostly_waits();
    check(&everything_at_once(1));
}

#[test]
fn kills_while_a_stage_starts_leave_nothing_that_grows() {
    check(&crashing_starts(Stage::DynamicCleaner, 40, 4));
}

#[test]
fn a_kill_while_the_map_is_saved_leaves_a_good_map() {
    machine_share::mostly_waits();
    check(&kills_while_saving(5, 5));
}

#[test]
fn damage_anywhere_in_a_saved_map_is_noticed() {
    let trial = torn_files(7);
    check(&trial);
    assert!(trial.runs > 1000, "only {} damages were tried", trial.runs);
}

#[test]
fn corrupt_scans_are_counted_and_cost_little() {
    check(&corrupt_scans(1..13));
}

#[test]
fn termination_saves_everything_in_time() {
    machine_share::mostly_waits();
    check(&terminations(2, 9));
}

/// Ten poses along a line, every second one with an accepted scan.
fn sound() -> Evidence {
    let pose = |i: u64| {
        let flags = if i.is_multiple_of(2) { PoseFlags::INSERT } else { 0 };
        let mut pose = PoseEstimate {
            flags,
            odom_from_base: Pose::new(0.02 * i as f64, 0.0, 0.0),
            ..PoseEstimate::default()
        };
        pose.id.sequence = i;
        pose.times.sensor_ns = i as i64 * 25_000_000;
        pose
    };
    Evidence { poses: (0..10).map(pose).collect(), inserted: 5, damage: Vec::new() }
}

#[test]
fn the_checker_finds_what_it_looks_for() {
    assert!(sound().violations().is_empty(), "{:?}", sound().violations());
    let text = |break_it: fn(&mut Evidence)| {
        let mut broken = sound();
        break_it(&mut broken);
        broken.violations().join("; ")
    };
    assert!(text(|evidence| evidence.inserted -= 1).contains("1 accepted scans are not in the map"));
    assert!(text(|evidence| evidence.inserted += 1).contains("1 scans are in the map twice"));
    assert!(text(|evidence| evidence.poses.swap(3, 4)).contains("scan 3 comes after scan 4"));
    assert!(text(|evidence| evidence.poses[6].odom_from_base.x_m += 0.5).contains("jumps by 0.5"));
    assert!(text(|evidence| evidence.poses[6].odom_from_base.heading_rad += 1.0).contains("1.00 rad"));
}
