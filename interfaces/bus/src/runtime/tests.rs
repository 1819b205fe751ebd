//! Tests of the runtime directory: creation, take-over and removal, with and without a folder on disk.

use super::*;

fn name(test: &str) -> String {
    format!("{test}-{}", std::process::id())
}

#[test]
fn without_a_folder_on_disk_everything_lies_in_the_directory() {
    let runtime = RuntimeDir::create(&name("nospill")).unwrap();
    assert_eq!(runtime.spill(), runtime.path());
    for directory in [runtime.journal(), runtime.submaps(), runtime.status(), runtime.results()] {
        assert!(directory.starts_with(runtime.path()) && directory.is_dir(), "{}", directory.display());
    }
}

#[test]
fn shared_objects_that_were_only_begun_are_removed_and_no_others() {
    let runtime = RuntimeDir::create(&name("begun")).unwrap();
    let object = |name: &str| Path::new(SHARED_MEMORY).join(format!("{}{name}", runtime.object_prefix()));
    fs::write(object("begun"), b"").unwrap();
    fs::write(object("whole"), b"x").unwrap();
    assert_eq!(runtime.remove_unfinished_objects(), 1);
    assert!(!object("begun").exists() && object("whole").exists());
    assert_eq!(runtime.remove_unfinished_objects(), 0);
}

#[test]
fn a_folder_on_disk_comes_and_goes_with_the_set_and_those_of_dead_sets_go_first() {
    let disk = tempfile::tempdir().unwrap();
    let spill_dir = disk.path().join("deep/spill");
    let dead = spill_dir.join("flockslam-spill-dead");
    fs::create_dir_all(dead.join("submaps")).unwrap();
    fs::write(dead.join(LOCK_FILE), b"").unwrap();
    fs::create_dir_all(spill_dir.join("not-ours")).unwrap();
    let runtime = RuntimeDir::create_spilling(&name("spill"), Some(&spill_dir)).unwrap();
    assert!(!dead.exists() && spill_dir.join("not-ours").exists());
    fs::write(runtime.submaps().join("x"), vec![0; 1 << 20]).unwrap();
    assert!(runtime.submaps().starts_with(&spill_dir));
    assert!(runtime.occupied_bytes() < 1 << 20, "what is on disk occupies no memory");
    let joined = RuntimeDir::open(runtime.path()).unwrap();
    assert_eq!(joined.spill(), runtime.spill());
    // Another set leaves the folder of a living one alone.
    let other = RuntimeDir::create_spilling(&name("other"), Some(&spill_dir)).unwrap();
    assert!(runtime.submaps().join("x").exists());
    drop(other);
    drop(runtime);
    assert_eq!(fs::read_dir(&spill_dir).unwrap().count(), 1);
}

#[test]
fn a_killed_sets_folder_is_removed_by_the_next_of_its_name() {
    let disk = tempfile::tempdir().unwrap();
    let mut killed = RuntimeDir::create_spilling(&name("killed"), Some(disk.path())).unwrap();
    // What a kill leaves: everything but the locks.
    (killed.lock, killed._spill_lock) = (None, None);
    fs::write(killed.submaps().join("x"), b"").unwrap();
    let again = RuntimeDir::create(&name("killed")).unwrap();
    assert!(!killed.submaps().exists() && again.submaps().exists());
}

#[test]
fn state_that_is_kept_outlives_its_supervisor_and_its_processes_remains_do_not() {
    let name = name("kept");
    let (mut killed, taken_over) = RuntimeDir::create_or_take_over(&name, None).unwrap();
    assert!(!taken_over && RuntimeDir::running().contains(&name));
    for path in [
        killed.configuration(),
        killed.journal().join("scans.journal"),
        killed.status().join("lidar-ingest.cursor"),
        killed.status().join("mapper-0.heartbeat"),
        killed.bus().join("node"),
    ] {
        fs::write(path, b"x").unwrap();
    }
    killed.lock = None;
    // A set of another name removes only sets that are not kept.
    drop(RuntimeDir::create(&format!("{name}-other")).unwrap());
    let (next, taken_over) = RuntimeDir::create_or_take_over(&name, None).unwrap();
    assert!(taken_over && next.journal().join("scans.journal").exists());
    assert!(next.status().join("lidar-ingest.cursor").exists() && next.configuration().exists());
    assert!(!next.status().join("mapper-0.heartbeat").exists() && !next.bus().join("node").exists());
    assert!(matches!(RuntimeDir::create_or_take_over(&name, None), Err(RuntimeError::Running(_))));
    drop(next);
    // A supervisor that failed for another reason leaves it all in place, too.
    let (mut next, taken_over) = RuntimeDir::create_or_take_over(&name, None).unwrap();
    assert!(taken_over && next.journal().join("scans.journal").exists());
    assert!(next.status().join("lidar-ingest.cursor").exists());
    next.wipe_at_end(true);
    drop(next);
    assert!(!RuntimeDir::path_of(&name).exists(), "an orderly end leaves nothing");
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let disk = tempfile::tempdir().unwrap();
    let file = disk.path().join("file");
    fs::write(&file, b"").unwrap();
    let error = RuntimeDir::create_spilling(&name("bad"), Some(&file)).err().unwrap().to_string();
    assert!(error.starts_with("set.spill_dir: ") && error.contains("file"), "{error}");
}

#[test]
fn names_are_refused_that_are_too_long_to_open_ports_with() {
    assert!(is_good_name(&"n".repeat(NAME_MAX)) && is_good_name("robot-7"));
    assert!(!is_good_name(&"n".repeat(NAME_MAX + 1)) && !is_good_name("") && !is_good_name("a/b"));
}

#[test]
fn the_folder_on_disk_of_a_killed_set_that_is_kept_is_left_alone_by_others_and_taken_over() {
    let disk = tempfile::tempdir().unwrap();
    let name = name("heir");
    let (mut killed, _) = RuntimeDir::create_or_take_over(&name, Some(disk.path())).unwrap();
    fs::write(killed.configuration(), b"{}").unwrap();
    fs::write(killed.journal().join("scans.journal"), b"x").unwrap();
    (killed.lock, killed._spill_lock) = (None, None);
    drop(RuntimeDir::create_spilling(&format!("{name}-b"), Some(disk.path())).unwrap());
    let (next, taken_over) = RuntimeDir::create_or_take_over(&name, Some(disk.path())).unwrap();
    assert!(taken_over && next.journal().join("scans.journal").exists());
    let folder = next.spill().to_owned();
    // What is left of a machine that was restarted is of no use.
    fs::write(folder.join(KEPT_MARK), b"another boot").unwrap();
    drop(next);
    fs::remove_dir_all(RuntimeDir::path_of(&name)).unwrap();
    drop(RuntimeDir::create_spilling(&format!("{name}-b"), Some(disk.path())).unwrap());
    assert!(!folder.exists());
}
