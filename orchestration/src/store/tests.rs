//! Tests of saved maps: saving in steps, foreign maps, a disk that refuses, flipped bits, cuts, and restoring.

use super::*;
use flockslam_bus::RuntimeDir;
use flockslam_evidence::{PackedCell, Submap, SubmapTile, TILE_CELLS, TileKey};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer};
use flockslam_results::SubmapStore;
use flockslam_results::flock_files::RecordLog;
use flockslam_stage::{JournalReader, JournalWriter, journal_file};
use std::fs;
use std::path::Path;

/// A set's directories with a small map in them.
struct Source {
    directory: tempfile::TempDir,
    journal: JournalWriter,
    next: u64,
}

impl Source {
    fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        fs::create_dir(directory.path().join("submaps")).unwrap();
        let journal = JournalWriter::open(directory.path()).unwrap();
        Self { directory, journal, next: 0 }
    }

    /// Journals scans, every second one accepted.
    fn drive(&mut self, scans: u64) {
        self.drive_with(scans, 0, 0);
    }

    /// The same with these flags of each pose, and the submap that it enters.
    fn drive_with(&mut self, scans: u64, more: u32, submap: u32) {
        let scan = ScanBuffer::from_ranges(&[1.0, 2.0, 3.0], -1.0, 1.0);
        for _ in 0..scans {
            let flags = if self.next.is_multiple_of(2) { PoseFlags::INSERT } else { 0 };
            let mut pose = PoseEstimate { flags: flags | more, submap, ..PoseEstimate::default() };
            pose.id.sequence = self.next;
            self.journal.append(&pose, scan.view().unwrap()).unwrap();
            self.next += 1;
        }
    }

    /// Closes a submap of the scans `first` to `last`.
    fn close(&self, number: u32, first: u64, last: u64) {
        let mut tile = SubmapTile::new(TileKey { x: 0, y: 0 }, Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
        tile.cleared[3] = 5;
        let submap = Submap {
            number,
            trajectory: 0,
            insertions: 2,
            first,
            last,
            odom_from_submap: Pose::IDENTITY,
            cell_size_m: 0.045,
            tiles: vec![tile],
        };
        SubmapStore::new(&self.directory.path().join("submaps")).save(&submap).unwrap();
    }

    fn mirror(&self, to: &Path) -> Mirror {
        let (path, head) = (self.directory.path(), MapHead::of_this_build("r1", 0.045));
        Mirror::new(path, &path.join("submaps"), path, SavedMap::at(to), head)
    }
}

/// A map of seven poses and two submaps, saved in a directory that is given back.
fn saved() -> (tempfile::TempDir, Source) {
    let (to, mut source) = (tempfile::tempdir().unwrap(), Source::new());
    source.drive(7);
    source.close(0, 0, 2);
    source.close(1, 4, 6);
    source.mirror(to.path()).bring_up().unwrap();
    (to, source)
}

fn whole() -> Findings {
    Findings { poses: 7, accepted: 4, submaps: 2, next_sequence: 7, problems: Vec::new() }
}

#[test]
fn what_is_new_is_saved_each_time_and_a_new_mirror_goes_on() {
    let (to, mut source) = saved();
    assert_eq!(SavedMap::at(to.path()).check().unwrap(), whole());
    source.drive(3);
    source.close(1, 4, 5);
    let mut mirror = source.mirror(to.path());
    mirror.bring_up().unwrap();
    let findings = SavedMap::at(to.path()).check().unwrap();
    assert_eq!((findings.poses, findings.submaps, findings.problems.len()), (10, 2, 0));
    source.drive(2);
    mirror.bring_up().unwrap();
    let findings = SavedMap::at(to.path()).check().unwrap();
    assert_eq!((findings.poses, findings.submaps, findings.problems.len()), (12, 2, 0));
    assert_eq!(
        SavedMap::at(to.path()).submaps().load(1).unwrap().last,
        5,
        "a replaced submap is saved again"
    );
    let bytes = |directory: &Path| fs::read(journal_file(directory)).unwrap();
    assert_eq!(bytes(to.path()), bytes(source.directory.path()));
}

#[test]
fn the_map_of_something_else_is_left_alone() {
    let (to, _) = saved();
    let before = files(to.path());
    let mut other = Source::new();
    other.drive(2);
    assert!(matches!(other.mirror(to.path()).bring_up(), Err(StoreError::Other(_))));
    assert_eq!(files(to.path()), before);
}

#[test]
fn a_disk_that_refuses_is_tried_again_and_nothing_is_missing() {
    let (to, mut source) = saved();
    let directory = to.path().join("r1");
    fs::write(&directory, b"in the way").unwrap();
    let mut mirror = source.mirror(&directory);
    assert!(matches!(mirror.bring_up(), Err(StoreError::Io { .. })));
    fs::remove_file(&directory).unwrap();
    mirror.bring_up().unwrap();
    source.drive(1);
    mirror.bring_up().unwrap();
    let more = Findings { poses: 8, next_sequence: 8, ..whole() };
    assert_eq!(SavedMap::at(&directory).check().unwrap(), more);
}

/// Every saved file with its bytes.
fn files(directory: &Path) -> Vec<(std::path::PathBuf, Vec<u8>)> {
    let mut paths = vec![directory.join("map.head"), journal_file(directory)];
    paths.extend((0..2).map(|number| SavedMap::at(directory).submaps().file(number)));
    paths.into_iter().map(|path| (path.clone(), fs::read(&path).unwrap())).collect()
}

/// A damaged map is rejected, reports a problem, or has other content than the undamaged one.
fn is_noticed(directory: &Path) -> bool {
    match SavedMap::at(directory).check() {
        Ok(findings) => !findings.problems.is_empty() || findings != whole(),
        Err(_) => true,
    }
}

#[test]
fn no_flipped_bit_is_accepted() {
    let (to, _source) = saved();
    let mut bits = 0;
    for (path, bytes) in files(to.path()) {
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, damaged).unwrap();
            assert!(is_noticed(to.path()), "{}: bit {bit}", path.display());
            bits += 1;
        }
        fs::write(&path, bytes).unwrap();
    }
    assert_eq!(SavedMap::at(to.path()).check().unwrap(), whole());
    println!("{bits} bits flipped, each noticed");
}

#[test]
fn no_cut_is_accepted_as_the_whole_map() {
    let (to, _source) = saved();
    for (path, bytes) in files(to.path()) {
        for length in 0..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            assert!(is_noticed(to.path()), "{} cut at {length}", path.display());
        }
        fs::write(&path, bytes).unwrap();
    }
}

#[test]
fn what_is_good_of_a_damaged_map_is_restored() {
    let (to, _source) = saved();
    let head = MapHead::of_this_build("r1", 0.045);
    let name = |test: &str| format!("restore-{test}-{}", std::process::id());
    let map = SavedMap::at(to.path());
    // A submap that is damaged is left out: the mapper makes it again from the journal.
    let submap = map.submaps().file(1);
    let bytes = fs::read(&submap).unwrap();
    fs::write(&submap, &bytes[1..]).unwrap();
    let runtime = RuntimeDir::create(&name("submap")).unwrap();
    let restored = map.restore(&runtime, &head).unwrap();
    assert_eq!((restored.next_sequence, restored.problems.len()), (7, 1));
    assert_eq!(SubmapStore::new(&runtime.submaps()).count(), 1);
    drop(runtime);
    assert_eq!(map.submaps().count(), 2, "what is only read stays as it is");
    // A journal that is damaged in the middle ends there, and so do the submaps; the damaged one is kept.
    let journal = journal_file(to.path());
    let mut bytes = fs::read(&journal).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&journal, &bytes).unwrap();
    let runtime = RuntimeDir::create(&name("journal")).unwrap();
    let restored = map.restore(&runtime, &head).unwrap();
    assert!(restored.next_sequence > 0 && restored.next_sequence < 7 && !restored.problems.is_empty());
    map.set_damage_aside(&restored).unwrap();
    assert_eq!(map.submaps().count(), restored.submaps);
    assert_eq!(fs::read(journal.with_extension("damaged")).unwrap(), bytes);
    let mut records = JournalReader::open(&runtime.journal()).unwrap();
    let mut count = 0;
    while records.read_next().unwrap().is_some() {
        count += 1;
    }
    assert_eq!(count, restored.next_sequence);
    // A map of other cells is refused.
    let coarse = MapHead::of_this_build("r1", 0.1);
    assert!(matches!(map.restore(&runtime, &coarse), Err(StoreError::Mismatch { .. })));
}

#[test]
fn records_of_the_flock_are_saved_and_restored_with_the_map() {
    let saved = tempfile::tempdir().unwrap();
    let mut source = Source::new();
    source.drive(4);
    let (mut log, _) = RecordLog::open(source.directory.path()).unwrap();
    log.append(b"one").unwrap();
    let mut mirror = source.mirror(saved.path());
    mirror.bring_up().unwrap();
    log.append(b"two").unwrap();
    mirror.bring_up().unwrap();
    assert_eq!(RecordLog::read(saved.path()).unwrap(), [b"one", b"two"]);
    let runtime = RuntimeDir::create(&format!("store-flock-{}", std::process::id())).unwrap();
    SavedMap::at(saved.path()).restore(&runtime, &MapHead::of_this_build("r1", 0.045)).unwrap();
    assert_eq!(RecordLog::read(&runtime.results()).unwrap(), [b"one", b"two"]);
}

#[test]
fn what_a_set_only_localizes_with_is_saved_once_its_map_is_made_further() {
    let (to, mut source) = saved();
    let mut mirror = source.mirror(to.path());
    source.drive_with(2, 0, 2);
    source.drive_with(6, PoseFlags::LOCALIZING, 2);
    source.close(2, 7, 8);
    source.close(3, 9, 12);
    mirror.bring_up().unwrap();
    let found = SavedMap::at(to.path()).check().unwrap();
    assert_eq!((found.poses, found.submaps, found.problems.len()), (9, 3, 0));
    // Only one at a time writes the journal of a saved map.
    drop(mirror);
    let mut mirror = source.mirror(to.path());
    mirror.bring_up().unwrap();
    assert_eq!(SavedMap::at(to.path()).check().unwrap(), found);
    source.drive_with(4, 0, 4);
    mirror.bring_up().unwrap();
    let found = SavedMap::at(to.path()).check().unwrap();
    assert_eq!((found.poses, found.submaps, found.problems.len()), (19, 4, 0));
}
