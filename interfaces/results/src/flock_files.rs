//! What a robot of a flock leaves beside its results: its records, and its own trajectory by names of scans.

use crate::ResultsError;
use flockslam_geometry::Pose;
use flockslam_journal::{Durability, RecordReader, RecordWriter, replace_file};
use std::fs;
use std::path::{Path, PathBuf};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Poses of all scans in the robot's own map.
pub const OWN_SCANS: &str = "flock-scans.rows";
/// Poses of the nodes of its graph.
pub const OWN_NODES: &str = "flock-nodes.rows";
const RECORDS: &str = "flock.records";
const RECORD: u32 = 1;

/// The pose of a scan that is named.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
pub struct NamedPose {
    /// Sequence of the scan.
    pub sequence: u64,
    /// Its sensor stamp, nanoseconds; 0 where nobody asks for it.
    pub stamp_ns: i64,
    /// `map_from_base`.
    pub pose: Pose,
}

/// Copies all of it from a set's results to where the user wants the outputs.
///
/// # Errors
/// When something is missing or the disk refuses.
pub fn keep(results: &Path, out: &Path) -> Result<(), ResultsError> {
    for name in [RECORDS, OWN_SCANS, OWN_NODES] {
        let from = results.join(name);
        let bytes = fs::read(&from).map_err(|e| ResultsError::file(&from, e))?;
        replace_file(&out.join(name), &bytes, Durability::Process)?;
    }
    Ok(())
}

/// Writes named poses.
///
/// # Errors
/// When the disk refuses.
pub fn write_named(directory: &Path, name: &str, rows: &[NamedPose]) -> Result<(), ResultsError> {
    Ok(replace_file(&directory.join(name), rows.as_bytes(), Durability::Process)?)
}

/// Reads named poses.
///
/// # Errors
/// When there are none, or the file is cut off.
pub fn read_named(directory: &Path, name: &str) -> Result<Vec<NamedPose>, ResultsError> {
    let path = directory.join(name);
    let bytes = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
    let rows = bytes.chunks(size_of::<NamedPose>()).map(NamedPose::read_from_bytes);
    rows.collect::<Result<_, _>>().map_err(|_| ResultsError::file(&path, "cut off in the middle of a pose"))
}

/// Where the records lie in a directory.
pub fn records_file(directory: &Path) -> PathBuf {
    directory.join(RECORDS)
}

/// A robot's log of records as a file: its own, and those of others that it has received.
pub struct RecordLog {
    writer: RecordWriter,
}

impl RecordLog {
    /// Opens the log in this directory, which is begun when there is none, and gives the records that it has.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn open(directory: &Path) -> Result<(Self, Vec<Vec<u8>>), ResultsError> {
        let path = records_file(directory);
        let writer = RecordWriter::open(&path)?;
        Ok((Self { writer }, Self::read(directory)?))
    }

    /// Appends a record.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn append(&mut self, record: &[u8]) -> Result<(), ResultsError> {
        Ok(self.writer.append(RECORD, &[record])?)
    }

    /// All records of the log in a directory.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn read(directory: &Path) -> Result<Vec<Vec<u8>>, ResultsError> {
        let mut reader = RecordReader::open(&directory.join(RECORDS))?;
        let mut records = Vec::new();
        while let Some(record) = reader.next_record()? {
            records.push(record.payload.to_vec());
        }
        Ok(records)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_and_poses_round_trip() {
        let directory = tempfile::tempdir().unwrap();
        let (mut log, before) = RecordLog::open(directory.path()).unwrap();
        assert!(before.is_empty());
        log.append(b"one").unwrap();
        drop(log);
        let (mut log, before) = RecordLog::open(directory.path()).unwrap();
        assert_eq!(before, [b"one"]);
        log.append(b"two").unwrap();
        assert_eq!(RecordLog::read(directory.path()).unwrap(), [b"one", b"two"]);
        let rows = [NamedPose { sequence: 7, stamp_ns: -3, pose: Pose::new(1.0, 2.0, 3.0) }];
        write_named(directory.path(), OWN_SCANS, &rows).unwrap();
        assert_eq!(read_named(directory.path(), OWN_SCANS).unwrap(), rows);
    }
}
