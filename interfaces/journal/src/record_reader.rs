//! Reading of journals: a file goes in, its good records come out, up to the first one that is torn.

use crate::JournalError;
use crate::format::{
    HEAD_BYTES, Head, RECORD_BYTES_MAX, RECORD_HEAD_BYTES, RecordHead, VERSION, head, read_head,
};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// A good record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Kind of the record, chosen by the writer.
    pub kind: u32,
    /// Its bytes.
    pub payload: &'a [u8],
}

/// The end of a journal after its last good record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Nothing: the journal is whole.
    Clean,
    /// An incomplete or damaged record, or a record that is just being written.
    Torn {
        /// Where it begins.
        offset: u64,
        /// Bytes from there to the end of the file.
        bytes: u64,
    },
}

/// Reads a journal from its first record to the last good one, one at a time into a buffer of its own.
///
/// It may follow a journal that is being written: after the end has been reported, [`Self::next_record`] may be asked
/// again.
///
/// ```
/// use flockslam_journal::{Ending, RecordReader, RecordWriter};
///
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("scans.journal");
/// RecordWriter::create(&path)?.append(7, &[b"a scan"])?;
/// // The last byte is lost.
/// let bytes = std::fs::read(&path)?;
/// std::fs::write(&path, &bytes[..bytes.len() - 1])?;
///
/// let mut reader = RecordReader::open(&path)?;
/// assert!(reader.next_record()?.is_none());
/// assert!(matches!(reader.ending(), Ending::Torn { .. }));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct RecordReader {
    file: File,
    path: PathBuf,
    /// Where the next record begins: the end of the last good one.
    offset: u64,
    buffer: Vec<u8>,
    /// Length of the file when it was looked at last, bytes.
    length: u64,
    /// Bytes from `ahead_offset` on that were read together.
    ahead: Vec<u8>,
    ahead_offset: u64,
    ending: Ending,
}

/// So many bytes are read together: a record of a scan is a fraction of that.
const AHEAD_BYTES: usize = 32 << 10;

impl RecordReader {
    /// Opens the journal at `path` for reading. A file that ends within its head (its writer died while making it)
    /// is an empty journal.
    ///
    /// # Errors
    /// When the file cannot be read, is not a journal, or has another version.
    pub fn open(path: &Path) -> Result<Self, JournalError> {
        let file = File::open(path).map_err(JournalError::io("open", path))?;
        Self::over(file, path)
    }

    pub(crate) fn over(file: File, path: &Path) -> Result<Self, JournalError> {
        let mut bytes = [0; HEAD_BYTES];
        let count = read_up_to(&file, &mut bytes, 0).map_err(JournalError::io("read", path))?;
        let path = path.to_owned();
        if count < HEAD_BYTES {
            if head()[..count] != bytes[..count] {
                return Err(JournalError::NotAJournal { path });
            }
            let ending = Ending::Torn { offset: 0, bytes: count as u64 };
            return Ok(Self::at(file, path, 0, ending));
        }
        match read_head(&bytes) {
            Head::Journal => Ok(Self::at(file, path, HEAD_BYTES as u64, Ending::Clean)),
            Head::OtherVersion(found) => Err(JournalError::UnknownVersion { path, found, known: VERSION }),
            Head::Foreign => Err(JournalError::NotAJournal { path }),
        }
    }

    fn at(file: File, path: PathBuf, offset: u64, ending: Ending) -> Self {
        let (buffer, ahead) = (Vec::new(), Vec::new());
        Self { file, path, offset, buffer, length: 0, ahead, ahead_offset: 0, ending }
    }

    /// The next good record, or `None` at the end; [`Self::ending`] then gives the state of the end.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn next_record(&mut self) -> Result<Option<Record<'_>>, JournalError> {
        match self.advance().map_err(JournalError::io("read", &self.path))? {
            Some(kind) => Ok(Some(Record { kind, payload: &self.buffer })),
            None => Ok(None),
        }
    }

    /// The state of the end, once [`Self::next_record`] has given `None`.
    pub fn ending(&self) -> Ending {
        self.ending
    }

    /// Where the last good record ends, bytes from the start of the file.
    pub fn good_bytes(&self) -> u64 {
        self.offset
    }

    /// Goes back to where a record begins that was read: it is read next.
    pub fn go_back_to(&mut self, offset: u64) {
        debug_assert!(offset <= self.offset, "it was read");
        self.offset = offset;
    }

    /// Goes on behind what was read before: up to there the journal is good.
    pub(crate) fn skip_to(&mut self, good_bytes: u64) {
        self.offset = self.offset.max(good_bytes);
    }

    /// Reads the record at the offset into the buffer and gives its kind.
    fn advance(&mut self) -> io::Result<Option<u32>> {
        // What was read ahead may be older than the end of a journal that is being written.
        let kind = self.advance_within_length()?;
        if kind.is_some() {
            return Ok(kind);
        }
        self.length = self.file.metadata()?.len();
        self.ahead.clear();
        self.advance_within_length()
    }

    /// The same in a file of the length that was read last.
    fn advance_within_length(&mut self) -> io::Result<Option<u32>> {
        let left = self.length.saturating_sub(self.offset);
        let torn = Ending::Torn { offset: self.offset, bytes: left };
        self.ending = if left == 0 { Ending::Clean } else { torn };
        if self.offset < HEAD_BYTES as u64 {
            self.ending = torn;
            return self.skip_head(left);
        }
        let mut bytes = [0; RECORD_HEAD_BYTES];
        if left < RECORD_HEAD_BYTES as u64 || self.read_up_to(&mut bytes, self.offset)? < RECORD_HEAD_BYTES {
            return Ok(None);
        }
        let found = RecordHead::decode(&bytes);
        let length = found.length as usize;
        // Nothing is allocated for a length that the file cannot hold.
        if length > RECORD_BYTES_MAX || left < (RECORD_HEAD_BYTES + length) as u64 {
            return Ok(None);
        }
        let mut buffer = std::mem::take(&mut self.buffer);
        buffer.resize(length, 0);
        let count = self.read_up_to(&mut buffer, self.offset + RECORD_HEAD_BYTES as u64)?;
        self.buffer = buffer;
        if count < length
            || found != RecordHead::of(found.length, found.kind, self.offset, [self.buffer.as_slice()])
        {
            return Ok(None);
        }
        self.offset += (RECORD_HEAD_BYTES + length) as u64;
        self.ending = Ending::Clean;
        Ok(Some(found.kind))
    }

    /// Fills as much of `to` as the file has at `offset`, and gives the number of bytes; reads ahead.
    fn read_up_to(&mut self, to: &mut [u8], offset: u64) -> io::Result<usize> {
        if to.len() > AHEAD_BYTES {
            return read_up_to(&self.file, to, offset);
        }
        let held = |ahead: &[u8], from: u64| {
            let start = usize::try_from(offset.checked_sub(from)?).ok()?;
            Some(start).filter(|start| start + to.len() <= ahead.len())
        };
        let start = match held(&self.ahead, self.ahead_offset) {
            Some(start) => start,
            None => {
                self.ahead.resize(AHEAD_BYTES, 0);
                let count = read_up_to(&self.file, &mut self.ahead, offset)?;
                self.ahead.truncate(count);
                self.ahead_offset = offset;
                0
            }
        };
        let bytes = &self.ahead[start..];
        let count = to.len().min(bytes.len());
        to[..count].copy_from_slice(&bytes[..count]);
        Ok(count)
    }

    /// A journal that was opened before its head was whole: goes on once the head is there.
    fn skip_head(&mut self, length: u64) -> io::Result<Option<u32>> {
        let mut bytes = [0; HEAD_BYTES];
        if length < HEAD_BYTES as u64
            || read_up_to(&self.file, &mut bytes, 0)? < HEAD_BYTES
            || read_head(&bytes) != Head::Journal
        {
            return Ok(None);
        }
        self.offset = HEAD_BYTES as u64;
        self.advance_within_length()
    }
}

/// Fills as much of `to` as the file has at `offset` and gives the number of bytes.
fn read_up_to(file: &File, to: &mut [u8], offset: u64) -> io::Result<usize> {
    let mut count = 0;
    while count < to.len() {
        match file.read_at(&mut to[count..], offset + count as u64) {
            Ok(0) => break,
            Ok(more) => count += more,
            Err(interrupted) if interrupted.kind() == io::ErrorKind::Interrupted => (),
            Err(problem) => return Err(problem),
        }
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RecordWriter;
    use std::fs;

    type Records = Vec<(u32, Vec<u8>)>;

    fn read_all(path: &Path) -> Result<(Records, Ending), JournalError> {
        let mut reader = RecordReader::open(path)?;
        let mut records = Vec::new();
        while let Some(record) = reader.next_record()? {
            records.push((record.kind, record.payload.to_vec()));
        }
        Ok((records, reader.ending()))
    }

    fn journal(path: &Path) -> (Records, Vec<u8>) {
        let records =
            vec![(7, b"first".to_vec()), (8, Vec::new()), (u32::MAX, (0..90).collect()), (0, vec![0; 9])];
        let mut writer = RecordWriter::create(path).unwrap();
        for (kind, payload) in &records {
            let (front, back) = payload.split_at(payload.len() / 3);
            writer.append(*kind, &[front, &[], back]).unwrap();
        }
        (records, fs::read(path).unwrap())
    }

    #[test]
    fn what_was_written_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let (records, _) = journal(&path);
        assert_eq!(read_all(&path).unwrap(), (records, Ending::Clean));
    }

    #[test]
    fn truncation_at_every_byte_leaves_the_whole_records_and_a_reopened_journal_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let (records, bytes) = journal(&path);
        for length in 0..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            let (found, ending) = read_all(&path).unwrap();
            let ends: Vec<usize> = (0..=records.len())
                .map(|count| records[..count].iter().map(|(_, payload)| RECORD_HEAD_BYTES + payload.len()))
                .map(|lengths| HEAD_BYTES + lengths.sum::<usize>())
                .collect();
            let whole = ends[1..].iter().filter(|end| **end <= length).count();
            assert_eq!(found, records[..whole], "cut at {length}");
            assert_eq!(ending == Ending::Clean, ends.contains(&length), "cut at {length}");
            RecordWriter::open(&path).unwrap().append(99, &[b"more"]).unwrap();
            let (continued, ending) = read_all(&path).unwrap();
            assert_eq!((continued.len(), ending), (found.len() + 1, Ending::Clean));
            assert_eq!(continued[..whole], found);
            assert_eq!(continued[whole], (99, b"more".to_vec()));
        }
    }

    #[test]
    fn no_flipped_bit_is_accepted() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let (records, bytes) = journal(&path);
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, &damaged).unwrap();
            match read_all(&path) {
                Ok((found, ending)) => {
                    assert!(found.len() < records.len() && found == records[..found.len()], "bit {bit}");
                    assert!(matches!(ending, Ending::Torn { .. }), "bit {bit}");
                }
                Err(JournalError::NotAJournal { .. }) => assert!(bit < 8 * HEAD_BYTES),
                Err(other) => panic!("bit {bit}: {other}"),
            }
        }
    }

    #[test]
    fn a_giant_length_is_not_allocated_and_a_moved_record_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let (records, bytes) = journal(&path);
        // More than a record may have, and as much as it may have, in a file that is shorter.
        for length in [u32::MAX, RECORD_BYTES_MAX as u32] {
            let giant = [&head()[..], &length.to_le_bytes(), &[0xff; 60]].concat();
            fs::write(&path, giant).unwrap();
            let mut reader = RecordReader::open(&path).unwrap();
            assert_eq!(reader.next_record().unwrap(), None);
            assert_eq!(reader.ending(), Ending::Torn { offset: 16, bytes: 64 });
            assert_eq!(reader.buffer.capacity(), 0);
        }
        let first = RECORD_HEAD_BYTES + records[0].1.len();
        let repeated = [&bytes[..HEAD_BYTES + first], &bytes[HEAD_BYTES..HEAD_BYTES + first]].concat();
        fs::write(&path, repeated).unwrap();
        assert_eq!(read_all(&path).unwrap().0, records[..1]);
    }

    #[test]
    fn a_reader_follows_a_journal_that_grows() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        fs::write(&path, b"floc").unwrap();
        let mut reader = RecordReader::open(&path).unwrap();
        assert_eq!(reader.next_record().unwrap(), None);
        let mut writer = RecordWriter::open(&path).unwrap();
        assert_eq!(reader.next_record().unwrap(), None);
        for kind in 0..3 {
            writer.append(kind, &[b"payload"]).unwrap();
            assert_eq!(reader.next_record().unwrap(), Some(Record { kind, payload: b"payload" }));
            assert_eq!(reader.next_record().unwrap(), None);
        }
    }

    #[test]
    fn foreign_files_and_versions_are_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        fs::write(&path, b"P5 some picture that is long enough").unwrap();
        assert!(matches!(RecordReader::open(&path), Err(JournalError::NotAJournal { .. })));
        assert!(matches!(RecordWriter::open(&path), Err(JournalError::NotAJournal { .. })));
        let none = dir.path().join("none");
        assert!(matches!(RecordReader::open(&none), Err(JournalError::Io { .. })));
        let mut later = head();
        later[8..12].copy_from_slice(&(VERSION + 1).to_le_bytes());
        let checksum = crc32fast::hash(&later[..12]);
        later[12..].copy_from_slice(&checksum.to_le_bytes());
        let other = dir.path().join("later");
        fs::write(&other, later).unwrap();
        for refused in [RecordReader::open(&other).err(), RecordWriter::open(&other).err()] {
            let refused = refused.expect("another version is refused");
            assert!(matches!(refused, JournalError::UnknownVersion { found, .. } if found == VERSION + 1));
        }
        for path in [path, none, other] {
            let error = RecordReader::open(&path).expect_err("it is refused").to_string();
            assert!(error.contains(path.to_str().unwrap()), "{error}");
        }
    }
}
