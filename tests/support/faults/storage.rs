//! Faults of what is stored: damaged files, a disk that refuses, and the time that the last save takes.

use super::{Seeded, Trial};
use crate::support::{Drive, LiveSet, PoseWatch, send, wait_for};
use flockslam::store::{Findings, SavedMap};
use flockslam_messages::Stage;
use rustix::process::Signal;
use std::fs;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const DRIVE: Drive = Drive { scan_rate_hz: 40.0, duration_s: 3600.0, rate: 1.0 };
/// What a set saves within this after SIGTERM is in time.
const STOP_LIMIT: Duration = Duration::from_secs(5);
/// Files longer than this are damaged at places drawn by lot in place of everywhere, bytes.
const WHOLE_BYTES: usize = 4096;

fn files_of(map: &Path) -> Vec<PathBuf> {
    let mut directories = vec![map.to_owned()];
    let mut files = Vec::new();
    while let Some(directory) = directories.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { directories.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    files
}

/// Damage is noticed when the map is refused, tells a problem, or admits to hold less than it did.
fn is_noticed(map: &SavedMap, whole: &Findings) -> bool {
    map.check().map_or(true, |found| !found.problems.is_empty() || found != *whole)
}

/// A saved map, each of whose files is cut at every byte and has every bit flipped; in long files, as many places at random.
pub fn torn_files(seed: u64) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let mut trial = Trial { fault: "a byte cut off or a bit flipped".to_owned(), ..Trial::default() };
    let path = directory.path().join("map");
    let more = format!("map = {path:?}\nsave_every_s = 0.2");
    let mut set = LiveSet::start("torn", directory.path(), DRIVE, &more);
    set.wait_until_handled(Stage::Mapper, 8);
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
    let map = SavedMap::at(&path);
    let whole = map.check().unwrap();
    assert!(whole.problems.is_empty(), "{whole:?}");
    for file in files_of(&path) {
        let bytes = fs::read(&file).unwrap();
        let opened = fs::OpenOptions::new().write(true).open(&file).unwrap();
        let tried = bytes.len().min(WHOLE_BYTES);
        let last = bytes.len() - tried;
        for step in 0..9 * tried {
            let (at, bit) = (last + step / 9, step % 9);
            // The end of a long file is the record that a kill may have torn; what is before it is damaged here and there.
            let at = if bit < 8 && last > 0 { random.below(bytes.len() as u64) as usize } else { at };
            // Only what is damaged is written, and then made good: the rest of a long file would take most of the time.
            let damaged = if bit == 8 { at..bytes.len() } else { at..at + 1 };
            match bit {
                8 => opened.set_len(at as u64).unwrap(),
                _ => opened.write_all_at(&[bytes[at] ^ 1 << bit], at as u64).unwrap(),
            }
            trial.runs += 1;
            if !is_noticed(&map, &whole) {
                let name = file.file_name().unwrap_or_default().to_string_lossy();
                trial.violations.push(format!("{name}: bit {bit} of byte {at} went unnoticed"));
            }
            opened.write_all_at(&bytes[damaged], at as u64).unwrap();
        }
        assert!(fs::read(&file).unwrap() == bytes, "it is as it was");
    }
    assert_eq!(map.check().unwrap(), whole);
    trial
}

/// A disk that refuses for a while, as many times: poses go on meanwhile, and saving goes on by itself.
pub fn refusing_disk(runs: usize) -> Trial {
    let directory = tempfile::tempdir().unwrap();
    let mut trial =
        Trial { fault: "a disk that refuses, until it saves again".to_owned(), ..Trial::default() };
    for run in 0..runs {
        let path = directory.path().join(format!("map-{run}"));
        fs::write(&path, b"in the way").unwrap();
        let mut set =
            LiveSet::start("refuse", directory.path(), DRIVE, &format!("map = {path:?}\nsave_every_s = 0.2"));
        set.wait_until_handled(Stage::ScanMatcher, 1);
        let poses = PoseWatch::start(&set.runtime_dir());
        set.wait_until("a reported problem", |status| {
            status.saved.as_ref().is_some_and(|saved| saved.problem.is_some() && !saved.durable)
        });
        wait_for("poses without a disk", || (poses.count() > 40).then_some(()));
        fs::remove_file(&path).unwrap();
        let since = Instant::now();
        set.wait_until("a saved map", |status| status.saved.as_ref().is_some_and(|saved| saved.durable));
        trial.recoveries_ms.push(since.elapsed().as_secs_f64() * 1e3);
        drop(poses);
        set.command_well(&["down"]);
        assert_eq!(set.wait(), Some(0));
        trial.violations.extend(SavedMap::at(&path).check().unwrap().problems);
        trial.runs += 1;
    }
    trial
}

/// SIGTERM to a driving set, as many times: how long it takes to save everything and end.
pub fn terminations(runs: usize, seed: u64) -> Trial {
    let (directory, mut random) = (tempfile::tempdir().unwrap(), Seeded::new(seed));
    let mut trial = Trial { fault: "SIGTERM, until all is saved".to_owned(), ..Trial::default() };
    for run in 0..runs {
        let path = directory.path().join(format!("map-{run}"));
        let mut set = LiveSet::start("stop", directory.path(), DRIVE, &format!("map = {path:?}"));
        let handled = set.wait_until_handled(Stage::ScanMatcher, 40 + random.below(80));
        let poses = crate::support::of(&handled, Stage::ScanMatcher).handled;
        let since = Instant::now();
        send(set.supervisor_pid(), Signal::TERM);
        assert_eq!(set.wait(), Some(0));
        let took = since.elapsed();
        trial.recoveries_ms.push(took.as_secs_f64() * 1e3);
        let found = SavedMap::at(&path).check().unwrap();
        trial.violations.extend(found.problems);
        if took > STOP_LIMIT || found.poses < poses {
            trial.violations.push(format!("{} of {poses} poses saved after {took:?}", found.poses));
        }
        trial.runs += 1;
    }
    trial
}
