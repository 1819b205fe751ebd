//! The store of closed submaps: the mapper writes it, sync-manager and a restarted mapper read it.

use crate::ResultsError;
use flockslam_evidence::{CellIndex, Submap, SubmapOutline, with_masked};
use flockslam_journal::{Durability, replace_file};
use flockslam_messages::{ScanId, SubmapClosed};
use std::fs;
use std::path::{Path, PathBuf};

const ENDING: &str = "submap";

/// Closed submaps as files, one each. A file is whole or absent: it is replaced atomically and its content is checked.
#[derive(Clone, Debug)]
pub struct SubmapStore {
    directory: PathBuf,
}

impl SubmapStore {
    /// The store in a directory that exists.
    pub fn new(directory: &Path) -> Self {
        Self { directory: directory.to_owned() }
    }

    /// Stores a submap under its number; a file of that number is replaced.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn save(&self, submap: &Submap) -> Result<(), ResultsError> {
        Ok(replace_file(&self.file(submap.number), &submap.encode(), Durability::Process)?)
    }

    /// Stores which cells of a submap are masked; all else of it must be as it is stored.
    ///
    /// # Errors
    /// When there is none of its number, its file is damaged, or the disk refuses.
    pub fn save_cleared(&self, submap: &Submap) -> Result<(), ResultsError> {
        let path = self.file(submap.number);
        let bytes = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
        let bytes = submap.encode_cleared(&bytes).map_err(|e| ResultsError::file(&path, e))?;
        Ok(replace_file(&path, &bytes, Durability::Process)?)
    }

    /// Masks cells of a stored submap, given in odom, beside those that are masked in it.
    ///
    /// # Errors
    /// When there is none of its number, its file is damaged, or the disk refuses.
    pub fn mask(&self, number: u32, cells: &[CellIndex]) -> Result<(), ResultsError> {
        let path = self.file(number);
        let bytes = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
        let bytes = with_masked(&bytes, cells).map_err(|e| ResultsError::file(&path, e))?;
        Ok(replace_file(&path, &bytes, Durability::Process)?)
    }

    /// The outline of the submap of this number.
    ///
    /// # Errors
    /// When there is none, or its file is damaged.
    pub fn load_outline(&self, number: u32) -> Result<SubmapOutline, ResultsError> {
        let path = self.file(number);
        let bytes = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
        SubmapOutline::decode(&bytes).map_err(|e| ResultsError::file(&path, e))
    }

    /// The submap of this number.
    ///
    /// # Errors
    /// When there is none, or its file is damaged.
    pub fn load(&self, number: u32) -> Result<Submap, ResultsError> {
        let path = self.file(number);
        let bytes = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
        Submap::decode(&bytes).map_err(|e| ResultsError::file(&path, e))
    }

    /// The message about a stored submap.
    ///
    /// # Errors
    /// When it is not stored.
    pub fn notice(&self, submap: &Submap) -> Result<SubmapClosed, ResultsError> {
        let path = self.file(submap.number);
        let bytes = fs::read(&path).map_err(|e| ResultsError::file(&path, e))?;
        let id = |sequence| ScanId { run: 1, lidar: 0, sequence };
        Ok(SubmapClosed {
            first: id(submap.first),
            last: id(submap.last),
            odom_from_submap: submap.odom_from_submap,
            checksum: checksum(&bytes),
            number: submap.number,
            insertions: submap.insertions,
        })
    }

    /// Bytes of all stored submaps.
    pub fn bytes(&self) -> u64 {
        let size = |number| fs::metadata(self.file(number)).map_or(0, |file| file.len());
        (0..self.count()).map(size).sum()
    }

    /// How many submaps there are: they are numbered from 0 without gaps.
    pub fn count(&self) -> u32 {
        (0..).find(|number| !self.has(*number)).expect("a directory is finite")
    }

    /// Whether the submap of this number is there.
    pub fn has(&self, number: u32) -> bool {
        self.file(number).exists()
    }

    /// The file of the submap of this number.
    pub fn file(&self, number: u32) -> PathBuf {
        self.directory.join(format!("{number:06}.{ENDING}"))
    }
}

fn checksum(bytes: &[u8]) -> u64 {
    // FNV-1a: tells versions apart; damage is found by the check inside the file.
    bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}
