use super::{MapHead, SavedMap, StoreError};
use flockslam_journal::{Durability, RecordReader, RecordWriter, replace_file};
use flockslam_stage::{SubmapStore, journal_file};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Brings a saved map up to what the set in a directory knows, by what is new since the last time.
pub struct Mirror {
    journal: PathBuf,
    submaps: SubmapStore,
    map: SavedMap,
    head: MapHead,
    open: Option<Open>,
    /// By number: which file of the set is saved.
    saved: Vec<FileStamp>,
}

/// Both ends of the journal, at the same place.
struct Open {
    from: RecordReader,
    to: RecordWriter,
}

/// Tells a replaced file from the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct FileStamp {
    inode: u64,
    modified_ns: i64,
}

impl Mirror {
    /// From the journal and the submaps of a set to a saved map, which is begun when there is none.
    pub fn new(journal_dir: &Path, submap_dir: &Path, map: SavedMap, head: MapHead) -> Self {
        Self {
            journal: journal_file(journal_dir),
            submaps: SubmapStore::new(submap_dir),
            map,
            head,
            open: None,
            saved: Vec::new(),
        }
    }

    /// Saves what is new, safe from a loss of power when this returns. Whatever dies on the way leaves a good map: the old one, or
    /// a part of the new one.
    ///
    /// # Errors
    /// When the disk refuses, or another map lies there: it may be tried again.
    pub fn bring_up(&mut self) -> Result<(), StoreError> {
        // Whatever the submaps know by now is in the journal, so the journal goes first.
        let submaps = self.submaps.count();
        let outcome = self.bring_up_journal();
        if outcome.is_err() {
            // The disk may have been exchanged, or the map be moved away: begin from what is there.
            self.open = None;
        }
        outcome?;
        (0..submaps).try_for_each(|number| self.bring_up_submap(number))
    }

    fn bring_up_journal(&mut self) -> Result<(), StoreError> {
        if !self.journal.exists() {
            return Ok(());
        }
        let open = match &mut self.open {
            Some(open) => open,
            None => {
                let opened = self.open()?;
                self.open.insert(opened)
            }
        };
        while let Some(record) = open.from.next_record()? {
            open.to.append(record.kind, &[record.payload])?;
        }
        Ok(open.to.sync()?)
    }

    fn open(&self) -> Result<Open, StoreError> {
        let directory = self.map.directory();
        fs::create_dir_all(directory.join("submaps")).map_err(StoreError::io(directory))?;
        if self.map.exists() {
            MapHead::read(directory)?.fits(directory, &self.head)?;
        } else {
            self.head.write(directory)?;
        }
        let to = RecordWriter::open(&journal_file(directory))?;
        let mut from = RecordReader::open(&self.journal)?;
        while from.good_bytes() < to.bytes() && from.next_record()?.is_some() {}
        let same = from.good_bytes() == to.bytes()
            && last_bytes(&self.journal, to.bytes())? == last_bytes(&journal_file(directory), to.bytes())?;
        if same { Ok(Open { from, to }) } else { Err(StoreError::Other(directory.to_owned())) }
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
