//! The journal of poses and accepted scans: the matcher writes it, other stages read it to recover missed scans.

use crate::StageError;
use flockslam_journal::{Ending, JournalError, RecordReader, RecordWriter, Refusal};
use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer, ScanHeader, ScanView};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use zerocopy::{FromBytes, IntoBytes};

/// A pose alone: the scan was not inserted.
const POSE: u32 = 1;
/// A pose with its scan: accepted, its evidence belongs into the map.
const ACCEPTED: u32 = 2;

/// The journal in a directory.
pub fn journal_file(directory: &Path) -> PathBuf {
    directory.join("scans.journal")
}

/// The matcher's side: every pose, with its scan when that is accepted, before the pose is published.
pub struct JournalWriter {
    records: RecordWriter,
    waiting: Waiting,
}

/// Records that a full disk refuses are kept in memory up to so many bytes; the oldest are lost then.
const WAITING_MAX_BYTES: usize = 64 << 20;

/// Records that were refused, oldest first.
#[derive(Default)]
struct Waiting {
    records: VecDeque<(u32, Vec<u8>)>,
    bytes: usize,
    refusal: Refusal,
}

impl Waiting {
    /// Keeps a record; how many older ones are lost by that.
    fn push(&mut self, kind: u32, parts: &[&[u8]]) -> u64 {
        let record = parts.concat();
        self.bytes += record.len();
        self.records.push_back((kind, record));
        self.refusal.set(true);
        let mut lost = 0;
        while self.bytes > WAITING_MAX_BYTES {
            let Some((_, oldest)) = self.records.pop_front() else { break };
            self.bytes -= oldest.len();
            lost += 1;
        }
        lost
    }

    /// Appends what waits, as far as there is room.
    fn append_to(&mut self, journal: &mut RecordWriter) -> Result<(), JournalError> {
        while let Some((kind, record)) = self.records.front() {
            journal.append(*kind, &[record])?;
            self.bytes -= record.len();
            self.records.pop_front();
        }
        self.refusal.set(false);
        Ok(())
    }
}

impl JournalWriter {
    /// Opens the journal behind its last whole record, or begins it.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn open(directory: &Path) -> Result<Self, StageError> {
        Ok(Self { records: RecordWriter::open(&journal_file(directory))?, waiting: Waiting::default() })
    }

    /// Opens the journal after the records that `reader` has read. They are not read again.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_behind(directory: &Path, reader: &JournalReader) -> Result<Self, StageError> {
        let good_bytes = reader.records.as_ref().map_or(0, RecordReader::good_bytes);
        let records = RecordWriter::open_from(&journal_file(directory), good_bytes)?;
        Ok(Self { records, waiting: Waiting::default() })
    }

    /// Appends a pose, with its scan when it is to be inserted. What a disk refuses waits in memory and is appended before the next
    /// record for which there is room.
    ///
    /// # Errors
    /// When the disk begins to refuse, and when records were lost since too many wait.
    pub fn append(&mut self, pose: &PoseEstimate, scan: ScanView<'_>) -> Result<(), JournalError> {
        if pose.has(PoseFlags::INSERT) {
            self.append_parts(
                ACCEPTED,
                &[pose.as_bytes(), scan.header().as_bytes(), scan.numbers().as_bytes()],
            )
        } else {
            self.append_parts(POSE, &[pose.as_bytes()])
        }
    }

    fn append_parts(&mut self, kind: u32, parts: &[&[u8]]) -> Result<(), JournalError> {
        let appended =
            self.waiting.append_to(&mut self.records).and_then(|()| self.records.append(kind, parts));
        let Err(error) = appended else { return Ok(()) };
        let is_known = self.waiting.refusal.is_set();
        let lost = self.waiting.push(kind, parts);
        if is_known && lost == 0 { Ok(()) } else { Err(error) }
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

/// Reads the journal from its start; it may still be growing, or not be there yet.
pub struct JournalReader {
    path: PathBuf,
    records: Option<RecordReader>,
    /// A record that was read and not returned yet.
    ahead: Option<Journaled>,
}

impl JournalReader {
    /// Opens the journal; an absent one is empty.
    ///
    /// # Errors
    /// When the file is there but cannot be read.
    pub fn open(directory: &Path) -> Result<Self, StageError> {
        let mut reader = Self { path: journal_file(directory), records: None, ahead: None };
        reader.open_once_there()?;
        Ok(reader)
    }

    fn open_once_there(&mut self) -> Result<(), StageError> {
        let empty = || std::fs::metadata(&self.path).map_or(true, |metadata| metadata.len() == 0);
        if self.records.is_none() && !empty() {
            self.records = Some(RecordReader::open(&self.path)?);
        }
        Ok(())
    }

    /// What follows the last good record, once the end was reached.
    pub fn ending(&self) -> Ending {
        self.records.as_ref().map_or(Ending::Clean, RecordReader::ending)
    }

    /// Where the next record begins.
    pub fn position(&self) -> u64 {
        self.records.as_ref().map_or(0, RecordReader::good_bytes)
    }

    /// The record that begins at this position, which was that of a record that has been read. Afterwards comes the one behind it.
    ///
    /// # Errors
    /// As [`Self::read_next`].
    pub fn read_at(&mut self, position: u64) -> Result<Option<Journaled>, StageError> {
        self.ahead = None;
        if let Some(records) = &mut self.records {
            records.go_back_to(position);
        }
        self.read_next()
    }

    /// The next record if it is of a scan before this sequence: the records that a reader at `sequence` has missed.
    ///
    /// # Errors
    /// As [`Self::read_next`].
    pub fn read_before(&mut self, sequence: u64) -> Result<Option<Journaled>, StageError> {
        let next = self.read_next()?;
        if next.as_ref().is_some_and(|record| record.pose.id.sequence >= sequence) {
            self.ahead = next;
            return Ok(None);
        }
        Ok(next)
    }

    /// The next record; `None` at the present end.
    ///
    /// # Errors
    /// When the file cannot be read, or a record is whole but not what this build writes.
    pub fn read_next(&mut self) -> Result<Option<Journaled>, StageError> {
        if self.ahead.is_some() {
            return Ok(self.ahead.take());
        }
        self.open_once_there()?;
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

/// The pose in a record of the journal; `None` in one that another build wrote.
pub fn pose_of(payload: &[u8]) -> Option<PoseEstimate> {
    PoseEstimate::read_from_prefix(payload).ok().map(|(pose, _)| pose)
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
        let mut early = JournalReader::open(directory.path()).unwrap();
        assert!(early.read_next().unwrap().is_none());
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
        assert!(early.read_next().unwrap().is_some(), "a journal that came later is read");
    }

    #[test]
    fn missed_records_are_read_up_to_a_sequence() {
        let directory = tempfile::tempdir().unwrap();
        let scan = ScanBuffer::from_ranges(&[1.0], 0.0, 1.0);
        let mut writer = JournalWriter::open(directory.path()).unwrap();
        for sequence in [3, 4, 7] {
            let mut pose = PoseEstimate::default();
            pose.id.sequence = sequence;
            writer.append(&pose, scan.view().unwrap()).unwrap();
        }
        let mut reader = JournalReader::open(directory.path()).unwrap();
        let mut before = |sequence| reader.read_before(sequence).unwrap().map(|r| r.pose.id.sequence);
        assert_eq!([before(5), before(5), before(5), before(5)], [Some(3), Some(4), None, None]);
        assert_eq!([before(7), before(8), before(8)], [None, Some(7), None]);
    }
}
