//! Copies what is new in the journal, the records and the submaps of a set to a saved map.

use super::{MapHead, SavedMap, StoreError};
use flockslam_journal::{Durability, RecordReader, RecordWriter, replace_file};
use flockslam_messages::PoseFlags;
use flockslam_results::SubmapStore;
use flockslam_results::flock_files::records_file;
use flockslam_stage::{journal_file, pose_of};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Brings a saved map up to what the set in a directory knows, by what is new since the last time.
pub struct Mirror {
    journal: PathBuf,
    /// The records of the robot and those that it has received, when it is part of a flock.
    records: PathBuf,
    submaps: SubmapStore,
    map: SavedMap,
    head: MapHead,
    open: Option<OpenJournal>,
    open_records: Option<Open>,
    /// By number: which file of the set is saved.
    saved: Vec<FileStamp>,
}

/// Both ends of a file of records, at the same place.
struct Open {
    from: RecordReader,
    to: RecordWriter,
}

/// The journal, read ahead: scans that a set only localizes with are saved once it makes its map further.
struct OpenJournal {
    open: Open,
    ahead: RecordReader,
    /// The last scan of the map ends here.
    map_bytes: u64,
    /// Submaps below this number are of the map; all when `None`.
    submaps: Option<u32>,
    /// That of the last accepted scan of the map.
    last_submap: u32,
}

impl OpenJournal {
    fn at(original: &Path, copy: &Path) -> Result<Self, StoreError> {
        let (open, ahead) = (Open::at(original, copy)?, RecordReader::open(original)?);
        Ok(Self { open, ahead, map_bytes: 0, submaps: None, last_submap: 0 })
    }

    fn bring_up(&mut self) -> Result<(), StoreError> {
        while let Some(record) = self.ahead.next_record()? {
            let pose = pose_of(record.payload);
            if pose.is_some_and(|pose| pose.has(PoseFlags::LOCALIZING)) {
                // The number of a scan may lag behind the submap that it enters, and is never ahead of it.
                self.submaps = Some(self.last_submap + 1);
                continue;
            }
            if let Some(pose) = pose.filter(|pose| pose.has(PoseFlags::INSERT)) {
                self.last_submap = pose.submap;
            }
            (self.map_bytes, self.submaps) = (self.ahead.good_bytes(), None);
        }
        let end = self.map_bytes;
        self.open.bring_up_to(end)
    }
}

impl Open {
    /// Both ends at the end of the copy, which must be a copy of this journal.
    fn at(original: &Path, copy: &Path) -> Result<Self, StoreError> {
        let to = RecordWriter::open(copy)?;
        let mut from = RecordReader::open(original)?;
        while from.good_bytes() < to.bytes() && from.next_record()?.is_some() {}
        let same = from.good_bytes() == to.bytes()
            && last_bytes(original, to.bytes())? == last_bytes(copy, to.bytes())?;
        let directory = copy.parent().unwrap_or(copy);
        if same { Ok(Self { from, to }) } else { Err(StoreError::Other(directory.to_owned())) }
    }

    fn bring_up(&mut self) -> Result<(), StoreError> {
        self.bring_up_to(u64::MAX)
    }

    /// Copies the records that end at `end` or before.
    fn bring_up_to(&mut self, end: u64) -> Result<(), StoreError> {
        while self.from.good_bytes() < end {
            let Some(record) = self.from.next_record()? else { break };
            self.to.append(record.kind, &[record.payload])?;
        }
        Ok(self.to.sync()?)
    }
}

/// Tells a replaced file from the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct FileStamp {
    inode: u64,
    modified_ns: i64,
}

impl Mirror {
    /// From what a set knows to a saved map, which is begun when there is none.
    pub fn new(
        journal_dir: &Path,
        submap_dir: &Path,
        result_dir: &Path,
        map: SavedMap,
        head: MapHead,
    ) -> Self {
        Self {
            journal: journal_file(journal_dir),
            records: records_file(result_dir),
            submaps: SubmapStore::new(submap_dir),
            map,
            head,
            open: None,
            open_records: None,
            saved: Vec::new(),
        }
    }

    /// Saves what is new, safe from a loss of power when this returns. A crash at any point leaves a good map: the old one, or
    /// a part of the new one.
    ///
    /// # Errors
    /// When the disk refuses, or another map is there: it may be tried again.
    pub fn bring_up(&mut self) -> Result<(), StoreError> {
        // Whatever the submaps and the flock know by now is in the journal, so the journal goes after that is counted.
        let submaps = self.submaps.count();
        let outcome = self.bring_up_records().and_then(|()| self.bring_up_journal());
        if outcome.is_err() {
            // The disk may have been exchanged, or the map be moved away: begin from what is there.
            (self.open, self.open_records) = (None, None);
        }
        outcome?;
        let of_map = self.open.as_ref().and_then(|open| open.submaps).unwrap_or(u32::MAX);
        let submaps = submaps.min(of_map);
        (0..submaps).try_for_each(|number| self.bring_up_submap(number))
    }

    fn bring_up_journal(&mut self) -> Result<(), StoreError> {
        if !self.journal.exists() {
            return Ok(());
        }
        if self.open.is_none() {
            self.begin()?;
            self.open = Some(OpenJournal::at(&self.journal, &journal_file(self.map.directory()))?);
        }
        self.open.iter_mut().try_for_each(OpenJournal::bring_up)
    }

    fn bring_up_records(&mut self) -> Result<(), StoreError> {
        if !self.records.exists() {
            return Ok(());
        }
        if self.open_records.is_none() {
            self.begin()?;
            self.open_records = Some(Open::at(&self.records, &records_file(self.map.directory()))?);
        }
        self.open_records.iter_mut().try_for_each(Open::bring_up)
    }

    /// Makes the map when there is none; what is there must be one of this kind.
    fn begin(&self) -> Result<(), StoreError> {
        let directory = self.map.directory();
        fs::create_dir_all(directory.join("submaps")).map_err(StoreError::io(directory))?;
        if self.map.exists() {
            MapHead::read(directory)?.fits(directory, &self.head)
        } else {
            self.head.write(directory)
        }
    }

    fn bring_up_submap(&mut self, number: u32) -> Result<(), StoreError> {
        let (from, to) = (self.submaps.file(number), self.map.submaps().file(number));
        let metadata = fs::metadata(&from).map_err(StoreError::io(&from))?;
        let stamp = FileStamp {
            inode: metadata.ino(),
            modified_ns: metadata.mtime().wrapping_mul(1_000_000_000).wrapping_add(metadata.mtime_nsec()),
        };
        let place = number as usize;
        if self.saved.get(place) == Some(&stamp) {
            return Ok(());
        }
        let bytes = fs::read(&from).map_err(StoreError::io(&from))?;
        if fs::read(&to).ok().as_ref() != Some(&bytes) {
            replace_file(&to, &bytes, Durability::Power)?;
        }
        match self.saved.get_mut(place) {
            Some(saved) => *saved = stamp,
            None => self.saved.push(stamp),
        }
        Ok(())
    }
}

/// The last bytes before `end`: of journals with the same ones there, that much is the same.
fn last_bytes(path: &Path, end: u64) -> Result<Vec<u8>, StoreError> {
    use std::os::unix::fs::FileExt;
    let mut bytes = vec![0; end.min(64) as usize];
    let file = fs::File::open(path).map_err(StoreError::io(path))?;
    file.read_exact_at(&mut bytes, end - end.min(64)).map_err(StoreError::io(path))?;
    Ok(bytes)
}
