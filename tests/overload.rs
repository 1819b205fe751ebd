//! Overload: a stage ten or a hundred times slower than it should be, and somebody else's work on all processors. A scan that is at most
//! a second old has its pose, what is left out is counted, shared memory grows by at most 64 MiB, no stage is replaced, and no accepted
//! scan is lost.

use crate::support::faults::{Overload, overload};
use crate::support::machine_share;
use flockslam_messages::Stage;

fn check(kind: Overload) {
    let complaints = overload(kind).complaints();
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn a_matcher_a_hundred_times_slower_leaves_poses_new_and_the_map_complete() {
    machine_share::mostly_waits();
    check(Overload::Slow(Stage::ScanMatcher, 100));
}

#[test]
fn a_mapper_ten_times_slower_leaves_poses_new_and_the_map_complete() {
    machine_share::mostly_waits();
    check(Overload::Slow(Stage::Mapper, 10));
}

#[test]
fn processors_that_are_busy_with_something_else_leave_poses_new_and_the_map_complete() {
    machine_share::alone();
    check(Overload::Hog);
}
