//! Writing of journals: records are appended at the end, under a lock that the process holds.

use crate::format::{HEAD_BYTES, PARTS_MAX, RECORD_BYTES_MAX, RECORD_HEAD_BYTES, RecordHead, head};
use crate::{JournalError, RecordReader};
use rustix::fs::{FlockOperation, flock};
use rustix::io::{Errno, pwritev};
use std::fs::{File, OpenOptions};
use std::io::{self, IoSlice};
use std::ops::Deref;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Appends records to a journal. A record that was appended survives the death of the process at once, and the loss
/// of power after the next [`Self::sync`]. One journal has one writer at a time.
///
/// ```
/// use flockslam_journal::{Ending, RecordReader, RecordWriter};
///
/// # let directory = tempfile::tempdir()?;
/// let path = directory.path().join("scans.journal");
/// let mut writer = RecordWriter::create(&path)?;
/// writer.append(7, &[b"header", b"ranges"])?;
///
/// let mut reader = RecordReader::open(&path)?;
/// let record = reader.next_record()?.expect("one record was written");
/// assert_eq!((record.kind, record.payload), (7, &b"headerranges"[..]));
/// assert!(reader.next_record()?.is_none());
/// assert_eq!(reader.ending(), Ending::Clean);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct RecordWriter {
    file: LockedFile,
    path: PathBuf,
    /// End of the last whole record.
    length: u64,
    /// An append failed half way: its remains lie behind `length`.
    torn: bool,
}

impl RecordWriter {
    /// Makes an empty journal at `path`, in place of any that was there.
    ///
    /// # Errors
    /// When the file cannot be made, or another writer has it.
    pub fn create(path: &Path) -> Result<Self, JournalError> {
        let file = open_locked(path)?;
        Self::begin(file, path)
    }

    /// Opens the journal at `path` to go on behind its last good record (a torn tail is cut off), or makes it.
    ///
    /// # Errors
    /// When the file cannot be opened, is not a journal, or another writer has it.
    pub fn open(path: &Path) -> Result<Self, JournalError> {
        Self::open_from(path, 0)
    }

    /// As [`Self::open`], for a caller that has read the journal up to `good_bytes` already: only later bytes are checked.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_from(path: &Path, good_bytes: u64) -> Result<Self, JournalError> {
        let file = open_locked(path)?;
        let copy = file.try_clone().map_err(JournalError::io("open", path))?;
        let mut reader = RecordReader::over(copy, path)?;
        reader.skip_to(good_bytes);
        while reader.next_record()?.is_some() {}
        let length = reader.good_bytes();
        if length < HEAD_BYTES as u64 {
            return Self::begin(file, path);
        }
        file.set_len(length).map_err(JournalError::io("cut the torn tail of", path))?;
        Ok(Self { file, path: path.to_owned(), length, torn: false })
    }

    fn begin(file: LockedFile, path: &Path) -> Result<Self, JournalError> {
        file.set_len(0)
            .and_then(|()| file.write_all_at(&head(), 0))
            .map_err(JournalError::io("begin", path))?;
        Ok(Self { file, path: path.to_owned(), length: HEAD_BYTES as u64, torn: false })
    }

    /// Appends one record whose payload is the parts one after the other, with one system call and no allocation.
    ///
    /// # Errors
    /// When the disk refuses: the journal then ends with the last whole record and may be tried again later.
    pub fn append(&mut self, kind: u32, parts: &[&[u8]]) -> Result<(), JournalError> {
        let bytes = parts.iter().fold(0_usize, |sum, part| sum.saturating_add(part.len()));
        if bytes > RECORD_BYTES_MAX || parts.len() > PARTS_MAX {
            return Err(JournalError::RecordTooLarge { bytes, parts: parts.len() });
        }
        if self.torn {
            self.cut().map_err(JournalError::io("repair", &self.path))?;
        }
        let length = u32::try_from(bytes).expect("a record's length was checked");
        let head = RecordHead::of(length, kind, self.length, parts.iter().copied()).encode();
        match write_all(&self.file, self.length, &head, parts) {
            Ok(()) => {
                self.length += (RECORD_HEAD_BYTES + bytes) as u64;
                Ok(())
            }
            Err(problem) => {
                // Otherwise later records would stand behind a torn one, where no reader finds them.
                self.torn = true;
                let _ = self.cut();
                Err(JournalError::io("append to", &self.path)(problem))
            }
        }
    }

    /// Returns when all records are safe from a loss of power.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn sync(&self) -> Result<(), JournalError> {
        self.file.sync_data().map_err(JournalError::io("sync", &self.path))
    }

    /// Bytes of the journal.
    pub fn bytes(&self) -> u64 {
        self.length
    }

    fn cut(&mut self) -> io::Result<()> {
        self.file.set_len(self.length)?;
        self.torn = false;
        Ok(())
    }
}

/// A file that no other writer has. The lock is released with it, and when the process ends.
#[derive(Debug)]
struct LockedFile(File);

impl Deref for LockedFile {
    type Target = File;

    fn deref(&self) -> &File {
        &self.0
    }
}

impl Drop for LockedFile {
    fn drop(&mut self) {
        // Closing it is not enough: a process that another thread has just started has a copy until it runs its own program.
        let _ = flock(&self.0, FlockOperation::Unlock);
    }
}

/// Opens without cutting anything: the lock is taken first.
fn open_locked(path: &Path) -> Result<LockedFile, JournalError> {
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)
        .map_err(JournalError::io("open", path))?;
    match flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(LockedFile(file)),
        Err(Errno::WOULDBLOCK) => Err(JournalError::Busy { path: path.to_owned() }),
        Err(problem) => Err(JournalError::io("lock", path)(problem)),
    }
}

/// Writes head and parts at `offset`, normally with one call; after a short write the rest follows part by part.
fn write_all(file: &File, offset: u64, head: &[u8], parts: &[&[u8]]) -> io::Result<()> {
    let mut slices = [IoSlice::new(&[]); PARTS_MAX + 1];
    let pieces = || std::iter::once(head).chain(parts.iter().copied());
    for (slice, piece) in slices.iter_mut().zip(pieces()) {
        *slice = IoSlice::new(piece);
    }
    let mut written = loop {
        match pwritev(file, &slices[..=parts.len()], offset) {
            Err(Errno::INTR) => (),
            other => break other?,
        }
    };
    let mut position = offset;
    for piece in pieces() {
        let done = written.min(piece.len());
        file.write_all_at(&piece[done..], position + done as u64)?;
        written -= done;
        position += piece.len() as u64;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kinds(path: &Path) -> Vec<u32> {
        let mut reader = RecordReader::open(path).unwrap();
        let mut kinds = Vec::new();
        while let Some(record) = reader.next_record().unwrap() {
            kinds.push(record.kind);
        }
        kinds
    }

    #[test]
    fn a_journal_has_one_writer_and_goes_on_after_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let mut first = RecordWriter::open(&path).unwrap();
        first.append(1, &[b"a"]).unwrap();
        first.sync().unwrap();
        assert!(matches!(RecordWriter::open(&path), Err(JournalError::Busy { .. })));
        assert!(matches!(RecordWriter::create(&path), Err(JournalError::Busy { .. })));
        assert_eq!(kinds(&path), [1]);
        // As a process has it that is just being started by another thread.
        let copy = first.file.try_clone().unwrap();
        drop(first);
        RecordWriter::open(&path).unwrap().append(2, &[b"b"]).unwrap();
        assert_eq!(kinds(&path), [1, 2]);
        RecordWriter::create(&path).unwrap();
        assert!(kinds(&path).is_empty());
        drop(copy);
    }

    #[test]
    fn a_failed_append_leaves_the_whole_records_and_can_be_repeated() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let mut writer = RecordWriter::create(&path).unwrap();
        writer.append(1, &[b"good"]).unwrap();
        // A descriptor that only reads stands for a disk that refuses.
        let working = std::mem::replace(&mut writer.file, LockedFile(File::open(&path).unwrap()));
        assert!(matches!(writer.append(2, &[b"lost"]), Err(JournalError::Io { .. })));
        assert!(matches!(writer.append(3, &[b"lost"]), Err(JournalError::Io { .. })));
        working.write_all_at(b"remains of the torn record", writer.bytes()).unwrap();
        writer.file = working;
        writer.append(4, &[b"good again"]).unwrap();
        assert_eq!(kinds(&path), [1, 4]);
    }

    #[test]
    fn too_large_records_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = RecordWriter::create(&dir.path().join("j")).unwrap();
        let parts = [&b""[..]; PARTS_MAX + 1];
        assert!(matches!(writer.append(0, &parts), Err(JournalError::RecordTooLarge { .. })));
        writer.append(0, &parts[1..]).unwrap();
    }

    /// System calls by which this thread has written so far, by the kernel's count.
    fn writing_calls() -> u64 {
        let counts = std::fs::read_to_string("/proc/thread-self/io").unwrap();
        let calls = counts.lines().find_map(|line| line.strip_prefix("syscw:")).unwrap();
        calls.trim().parse().unwrap()
    }

    #[test]
    fn appending_a_scan_takes_one_system_call_and_twelve_bytes_more_than_the_scan() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let mut writer = RecordWriter::create(&path).unwrap();
        let (header, ranges) = ([1_u8; 200], [2_u8; 1440]);
        let before = writing_calls();
        for kind in 0..100 {
            writer.append(kind, &[&header, &ranges]).unwrap();
        }
        assert_eq!(writing_calls() - before, 100);
        assert_eq!(writer.bytes(), 16 + 100 * (12 + 200 + 1440));
        assert_eq!(std::fs::metadata(&path).unwrap().len(), writer.bytes());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn arbitrary_files_are_survived(tail in prop::collection::vec(any::<u8>(), 0..300), own_head: bool) {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("j");
            let start = if own_head { head().to_vec() } else { Vec::new() };
            let bytes = [start, tail].concat();
            std::fs::write(&path, &bytes).unwrap();
            match RecordWriter::open(&path) {
                Ok(mut writer) => {
                    writer.append(5, &[b"x"]).unwrap();
                    prop_assert_eq!(kinds(&path).last().copied(), Some(5));
                }
                // A file that is no journal is left as it is.
                Err(_) => {
                    prop_assert!(!own_head);
                    prop_assert_eq!(std::fs::read(&path).unwrap(), bytes);
                }
            }
        }
    }
}
