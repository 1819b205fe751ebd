use crate::StageError;
use flockslam_journal::{JournalError, RecordReader, RecordWriter};
use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer, ScanHeader, ScanView};
use std::path::{Path, PathBuf};
use zerocopy::{FromBytes, IntoBytes};

/// A pose alone: the scan was not inserted.
const POSE: u32 = 1;
/// A pose with its scan: accepted, its evidence belongs into the map.
const ACCEPTED: u32 = 2;

fn journal_file(directory: &Path) -> PathBuf {
    directory.join("scans.journal")
}

/// The matcher's side: every pose, and the scan beside it when it is accepted, before anybody is told.
pub struct JournalWriter {
    records: RecordWriter,
}

impl JournalWriter {
    /// Opens the journal behind its last whole record, or begins it.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn open(directory: &Path) -> Result<Self, StageError> {
        Ok(Self { records: RecordWriter::open(&journal_file(directory))? })
    }

    /// Appends a pose, with its scan when it is to be inserted.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn append(&mut self, pose: &PoseEstimate, scan: ScanView<'_>) -> Result<(), JournalError> {
        if pose.has(PoseFlags::INSERT) {
            self.records
                .append(ACCEPTED, &[pose.as_bytes(), scan.header().as_bytes(), scan.numbers().as_bytes()])
        } else {
            self.records.append(POSE, &[pose.as_bytes()])
        }
    }
}

/// A record of the journal.
#[derive(Clone, Debug)]
pub struct Journaled {
    /// The pose.
    pub pose: PoseEstimate,
    /// The scan, when it was accepted.
    pub scan: Option<ScanBuffer>,
}

/// Reads the journal from its beginning; it may still be growing.
pub struct JournalReader {
    records: Option<RecordReader>,
}

impl JournalReader {
    /// Opens the journal; an absent one is empty.
    ///
    /// # Errors
    /// When the file is there but cannot be read.
    pub fn open(directory: &Path) -> Result<Self, StageError> {
        let path = journal_file(directory);
        let empty = std::fs::metadata(&path).map_or(true, |metadata| metadata.len() == 0);
        Ok(Self { records: if empty { None } else { Some(RecordReader::open(&path)?) } })
    }

    /// The next record; `None` at the present end.
    ///
    /// # Errors
    /// When the file cannot be read, or a record is whole but not what this build writes.
    pub fn read_next(&mut self) -> Result<Option<Journaled>, StageError> {
        let Some(records) = &mut self.records else { return Ok(None) };
        let Some(record) = records.next_record()? else { return Ok(None) };
        let foreign = || StageError::file("scans.journal", "a record was written by another build");
        let (pose, rest) = PoseEstimate::read_from_prefix(record.payload).map_err(|_| foreign())?;
        let scan = match record.kind {
            POSE if rest.is_empty() => None,
            ACCEPTED => Some(decode_scan(rest).ok_or_else(foreign)?),
            _ => return Err(foreign()),
        };
        Ok(Some(Journaled { pose, scan }))
    }
}

fn decode_scan(bytes: &[u8]) -> Option<ScanBuffer> {
    let (header, numbers) = ScanHeader::read_from_prefix(bytes).ok()?;
    if numbers.len() % 4 != 0 {
        return None;
    }
    let numbers = numbers
        .chunks_exact(4)
        .map(|four| f32::from_ne_bytes([four[0], four[1], four[2], four[3]]))
        .collect();
    let scan = ScanBuffer { header, numbers };
    scan.view().ok()?;
    Some(scan)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_and_accepted_scans_come_back_and_reopening_appends() {
        let directory = tempfile::tempdir().unwrap();
        assert!(JournalReader::open(directory.path()).unwrap().read_next().unwrap().is_none());
        let scan = ScanBuffer::from_ranges(&[1.0, 2.0, f32::INFINITY], -1.0, 1.0);
        for (submap, flags) in [(1, 0), (2, PoseFlags::INSERT)] {
            let mut writer = JournalWriter::open(directory.path()).unwrap();
            let pose = PoseEstimate { submap, flags, ..PoseEstimate::default() };
            writer.append(&pose, scan.view().unwrap()).unwrap();
        }
        let mut reader = JournalReader::open(directory.path()).unwrap();
        let first = reader.read_next().unwrap().unwrap();
        assert!(first.pose.submap == 1 && first.scan.is_none());
        let second = reader.read_next().unwrap().unwrap();
        assert!(second.pose.submap == 2 && second.scan == Some(scan));
        assert!(reader.read_next().unwrap().is_none());
    }
}
