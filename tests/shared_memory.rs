//! Scans and tiles are read in place: their addresses in the readers lie in the very memory of their publisher.
//! A release build does not tell where it reads.
#![cfg(debug_assertions)]

use crate::support;
use crate::support::{RunningSet, live_building};
use flockslam_messages::Stage;
use std::path::PathBuf;

/// A file in a process' memory.
#[derive(Debug)]
struct Mapping {
    begin: u64,
    end: u64,
    permissions: String,
    inode: u64,
    file: PathBuf,
}

fn mappings(pid: u32) -> Vec<Mapping> {
    let maps = std::fs::read_to_string(format!("/proc/{pid}/maps")).unwrap();
    maps.lines().filter_map(parse).collect()
}

/// A line is `begin-end permissions offset device inode path`.
fn parse(line: &str) -> Option<Mapping> {
    let fields: Vec<&str> = line.split_ascii_whitespace().collect();
    let (begin, end) = fields[0].split_once('-')?;
    Some(Mapping {
        begin: u64::from_str_radix(begin, 16).ok()?,
        end: u64::from_str_radix(end, 16).ok()?,
        permissions: fields[1].to_owned(),
        inode: fields[4].parse().ok()?,
        file: PathBuf::from(fields.get(5)?),
    })
}

/// The publisher's data segment that holds this address of the reader.
fn segment_of(address: u64, reader: u32, publisher: u32) -> Mapping {
    let of_reader = mappings(reader);
    let held = of_reader.into_iter().find(|mapping| (mapping.begin..mapping.end).contains(&address));
    let held = held.unwrap_or_else(|| panic!("{address:#x} is in no file that {reader} maps"));
    assert!(held.file.starts_with("/dev/shm"), "{held:?}");
    assert_eq!(held.file.extension().unwrap(), "data", "{held:?}");
    assert_eq!(held.permissions, "r--s", "readers only read");
    let of_publisher = mappings(publisher).into_iter().find(|mapping| mapping.inode == held.inode);
    let of_publisher = of_publisher.unwrap_or_else(|| panic!("{publisher} does not map {held:?}"));
    assert_eq!(
        (&of_publisher.file, of_publisher.permissions.as_str()),
        (&held.file, "rw-s"),
        "the publisher writes"
    );
    held
}

#[test]
fn scans_and_tiles_lie_in_the_memory_of_their_publishers() {
    let directory = tempfile::tempdir().unwrap();
    let set = RunningSet::start("memory", directory.path(), &live_building(250, 5));
    let ingest = set.pid(Stage::LidarIngest);
    let readers = [
        Stage::CorrelationFilter,
        Stage::ScanMatcher,
        Stage::Mapper,
        Stage::DynamicCleaner,
        Stage::SyncManager,
    ];
    let mut segments: Vec<_> = readers
        .into_iter()
        .map(|stage| {
            let report = set.report_with(stage, |report| report.scan_address != 0);
            assert_eq!(report.pid, set.pid(stage));
            segment_of(report.scan_address, report.pid, ingest).file
        })
        .collect();
    segments.dedup();
    assert_eq!(segments.len(), 1, "all read the same segment");
    println!("scans: {}", segments[0].display());
    let mapper = set.pid(Stage::Mapper);
    for stage in [Stage::ScanMatcher, Stage::DynamicCleaner] {
        let report = set.report_with(stage, |report| report.tile_address != 0);
        let segment = segment_of(report.tile_address, report.pid, mapper);
        println!("tiles: {} ({} MiB laid out)", segment.file.display(), (segment.end - segment.begin) >> 20);
        assert!(!segments.contains(&segment.file));
    }
    support::send(set.supervisor_pid(), rustix::process::Signal::INT);
    let outputs = set.finish();
    println!("{} MiB of shared memory in all", outputs.report.shared_memory_bytes >> 20);
}
