//! `set.spill_dir`: closed submaps lie on disk as long as a set runs, and the result is the same.

use crate::support::{RunningSet, building, live_building, run, run_well, stderr, wait_for};
use std::path::Path;

fn with_spill(mut args: Vec<String>, spill_dir: &Path) -> Vec<String> {
    args.extend(["--set".to_owned(), format!("set.spill_dir={}", spill_dir.display())]);
    args
}

/// Folders of sets in a directory.
fn folders(spill_dir: &Path) -> usize {
    std::fs::read_dir(spill_dir).map_or(0, Iterator::count)
}

#[test]
fn the_result_is_the_same_and_nothing_is_left() {
    let directory = tempfile::tempdir().unwrap();
    let spill_dir = directory.path().join("spill");
    let plain = run_well("memory", &directory.path().join("memory"), &building(40));
    let spilled = run_well("disk", &directory.path().join("disk"), &with_spill(building(40), &spill_dir));
    assert_eq!(spilled.report.map_hash, plain.report.map_hash);
    assert!(spilled.bytes("trajectory.tum") == plain.bytes("trajectory.tum"), "the trajectory differs");
    assert!(spilled.report.submap_bytes > 0 && spilled.report.submap_bytes == plain.report.submap_bytes);
    assert_eq!(folders(&spill_dir), 0);
}

#[test]
fn submaps_of_a_running_set_lie_on_disk_and_those_of_a_killed_one_are_removed_by_the_next() {
    let directory = tempfile::tempdir().unwrap();
    let spill_dir = directory.path().join("spill");
    let set = RunningSet::start("kept", directory.path(), &with_spill(live_building(600, 40), &spill_dir));
    let folder = spill_dir.join(format!("flockslam-spill-{}", set.robot()));
    wait_for("a submap on disk", || folder.join("submaps/000000.submap").exists().then_some(()));
    // Killed with its supervisor, it leaves the folder to the next.
    drop(set);
    assert!(folder.exists());
    run_well("next", &directory.path().join("next"), &with_spill(building(5), &spill_dir));
    assert_eq!(folders(&spill_dir), 0);
}

#[test]
fn a_directory_that_cannot_be_used_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("file");
    std::fs::write(&file, b"").unwrap();
    let output = run("refused", &directory.path().join("out"), &with_spill(building(5), &file));
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(text.lines().count() == 1 && text.starts_with("flockslam: set.spill_dir: "), "{text}");
}
