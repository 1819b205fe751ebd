//! Overload: a stage ten or a hundred times slower than it should be, and somebody else's work on all processors. The newest scans get their
//! poses, what is left out is counted, memory stays what was laid out, and nothing that was accepted is lost.

use crate::support::faults::{Overload, overload};
use flockslam_messages::Stage;

fn judge(kind: Overload) {
    let complaints = overload(kind).complaints();
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn a_matcher_a_hundred_times_slower() {
    judge(Overload::Slow(Stage::ScanMatcher, 100));
}

#[test]
fn a_mapper_ten_times_slower() {
    judge(Overload::Slow(Stage::Mapper, 10));
}

#[test]
fn processors_that_are_busy_with_something_else() {
    judge(Overload::Hog);
}
