//! The place in the stream that a source continues from after a restart, in a file.

use super::pacer::Anchor;
use flockslam_stage::StageError;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// How far a live source has come, kept on tmpfs: after a kill the next process goes on behind the last scan sent.
#[derive(Debug)]
pub struct Cursor {
    file: File,
    path: PathBuf,
    next: u64,
    anchor: Option<Anchor>,
}

const BYTES: usize = 24;

impl Cursor {
    /// Opens the cursor of a set; one that does not exist yet begins at `first`.
    pub fn open(status_dir: &Path, first: u64) -> Result<Self, StageError> {
        let path = status_dir.join("lidar-ingest.cursor");
        let options = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let file = options.map_err(|e| StageError::file(&path, e))?;
        let mut bytes = [0; BYTES];
        let (mut next, mut anchor) = (first, None);
        if file.read_exact_at(&mut bytes, 0).is_ok() {
            let word =
                |i: usize| u64::from_le_bytes(bytes[8 * i..8 * i + 8].try_into().expect("eight bytes"));
            next = word(0);
            anchor = (word(1) != 0).then_some(Anchor { monotonic_ns: word(1), stamp_ns: word(2) as i64 });
        }
        Ok(Self { file, path, next, anchor })
    }

    /// Sequence of the next scan.
    pub fn next_sequence(&self) -> u64 {
        self.next
    }

    /// Anchor of the replay on the clock.
    pub fn anchor(&self) -> Option<Anchor> {
        self.anchor
    }

    /// All scans below `next` were sent.
    pub fn advance(&mut self, next: u64, anchor: Option<Anchor>) -> Result<(), StageError> {
        (self.next, self.anchor) = (next, anchor.or(self.anchor));
        let (monotonic_ns, stamp_ns) =
            self.anchor.map_or((0, 0), |anchor| (anchor.monotonic_ns, anchor.stamp_ns));
        let mut bytes = [0; BYTES];
        for (to, word) in bytes.chunks_exact_mut(8).zip([self.next, monotonic_ns, stamp_ns as u64]) {
            to.copy_from_slice(&word.to_le_bytes());
        }
        self.file.write_all_at(&bytes, 0).map_err(|e| StageError::file(&self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_process_goes_on_where_the_last_one_was() {
        let directory = tempfile::tempdir().unwrap();
        let mut cursor = Cursor::open(directory.path(), 7).unwrap();
        assert_eq!((cursor.next_sequence(), cursor.anchor()), (7, None));
        let anchor = Anchor { monotonic_ns: 5, stamp_ns: -7 };
        cursor.advance(41, Some(anchor)).unwrap();
        cursor.advance(42, None).unwrap();
        let cursor = Cursor::open(directory.path(), 7).unwrap();
        assert_eq!((cursor.next_sequence(), cursor.anchor()), (42, Some(anchor)));
    }
}
