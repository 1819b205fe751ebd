//! A file that grows at its end. What a full disk refuses waits in memory until there is room.

use crate::JournalError;
use crate::refusal::Refusal;
use std::fs::{File, rename};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// So much is written at once, bytes.
const CHUNK_BYTES: usize = 8 << 10;

/// Rows that are appended to a file of one writer.
#[derive(Debug)]
pub struct GrowingFile {
    file: File,
    path: PathBuf,
    /// Bytes that are in the file.
    written: u64,
    /// Bytes that are not.
    waiting: Vec<u8>,
    /// It is tried again when so many bytes wait.
    next_try: usize,
    refusal: Refusal,
}

impl GrowingFile {
    /// An empty one, in place of any that was there.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn create(path: PathBuf) -> Result<Self, JournalError> {
        let file = File::options().read(true).write(true).create(true).truncate(true).open(&path);
        let file = file.map_err(JournalError::io("make", &path))?;
        let (written, waiting, next_try) = (0, Vec::with_capacity(CHUNK_BYTES), CHUNK_BYTES);
        Ok(Self { file, path, written, waiting, next_try, refusal: Refusal::default() })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes that were appended, those that wait among them.
    pub fn bytes(&self) -> u64 {
        self.written + self.waiting.len() as u64
    }

    /// Appends bytes, which reach the file with later ones, or by [`Self::flush`].
    pub fn push(&mut self, bytes: &[u8]) {
        self.waiting.extend_from_slice(bytes);
        if self.waiting.len() >= self.next_try {
            // They wait on.
            let _ = self.flush();
        }
    }

    /// Writes all that waits.
    ///
    /// # Errors
    /// When the disk refuses: it waits in memory.
    pub fn flush(&mut self) -> Result<(), JournalError> {
        let outcome = self.file.write_all_at(&self.waiting, self.written);
        self.refusal.set(outcome.is_err());
        if outcome.is_ok() {
            self.written += self.waiting.len() as u64;
            self.waiting.clear();
        }
        self.next_try = self.waiting.len() + CHUNK_BYTES;
        outcome.map_err(JournalError::io("append to", &self.path))
    }

    /// Gives it another name on the same disk.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn rename(&mut self, to: PathBuf) -> Result<(), JournalError> {
        rename(&self.path, &to).map_err(JournalError::io("rename", &self.path))?;
        self.path = to;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::is_durable;

    #[test]
    fn what_is_refused_waits_and_is_written_in_its_order() {
        let dir = tempfile::tempdir().unwrap();
        let mut rows = GrowingFile::create(dir.path().join("rows")).unwrap();
        rows.push(b"first ");
        rows.flush().unwrap();
        // A descriptor that only reads stands for a disk that refuses.
        let reader = File::open(rows.path()).unwrap();
        let working = std::mem::replace(&mut rows.file, reader);
        rows.push(&[b'x'; CHUNK_BYTES]);
        assert!(rows.flush().is_err() && !is_durable());
        rows.push(b" last");
        rows.file = working;
        rows.rename(dir.path().join("other")).unwrap();
        rows.flush().unwrap();
        assert!(is_durable());
        let text = std::fs::read_to_string(dir.path().join("other")).unwrap();
        assert!(text.starts_with("first xx") && text.ends_with("xx last"));
        assert_eq!(text.len(), 11 + CHUNK_BYTES);
    }
}
