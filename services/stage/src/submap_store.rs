use crate::StageError;
use flockslam_evidence::{PackedCell, Submap, SubmapTile, TILE_CELLS, TileKey};
use flockslam_journal::{Durability, replace_file};
use flockslam_messages::{ScanId, SubmapClosed};
use std::fs;
use std::path::{Path, PathBuf};
use zerocopy::{FromBytes, IntoBytes};

const ENDING: &str = "submap";
/// Folder of the parts of submaps that are not whole yet.
const PARTS: &str = "parts";

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
    pub fn save(&self, submap: &Submap) -> Result<(), StageError> {
        Ok(replace_file(&self.file(submap.number), &submap.encode(), Durability::Process)?)
    }

    /// The submap of this number.
    ///
    /// # Errors
    /// When there is none, or its file is damaged.
    pub fn load(&self, number: u32) -> Result<Submap, StageError> {
        let path = self.file(number);
        let bytes = fs::read(&path).map_err(|e| StageError::file(&path, e))?;
        Submap::decode(&bytes).map_err(|e| StageError::file(&path, e))
    }

    /// What is told about a stored submap.
    ///
    /// # Errors
    /// When it is not stored.
    pub fn notice(&self, submap: &Submap) -> Result<SubmapClosed, StageError> {
        let path = self.file(submap.number);
        let bytes = fs::read(&path).map_err(|e| StageError::file(&path, e))?;
        let id = |sequence| ScanId { epoch: 1, lidar: 0, sequence };
        Ok(SubmapClosed {
            first: id(submap.first),
            last: id(submap.last),
            odom_from_submap: submap.odom_from_submap,
            checksum: checksum(&bytes),
            number: submap.number,
            insertions: submap.insertions,
        })
    }

    /// Stores the tiles of a submap that one of several mappers looks after, until all of them are there: cell by cell, since how a
    /// whole submap is rounded depends on all of its cells.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn save_part(&self, submap: &Submap, part: u32, parts: u32) -> Result<(), StageError> {
        let directory = self.directory.join(PARTS);
        fs::create_dir_all(&directory).map_err(|e| StageError::file(&directory, e))?;
        let path = self.part_file(submap.number, part, parts);
        let mut bytes = Vec::with_capacity(submap.tiles.len() * PART_TILE_BYTES);
        for tile in &submap.tiles {
            bytes.extend_from_slice(tile.key.as_bytes());
            bytes.extend_from_slice(tile.cells.as_bytes());
        }
        Ok(replace_file(&path, &bytes, Durability::Process)?)
    }

    /// The parts of a submap that others than the first mapper have stored; `None` while one is missing.
    ///
    /// # Errors
    /// When a part cannot be read.
    pub fn load_parts(&self, number: u32, parts: u32) -> Result<Option<Vec<SubmapTile>>, StageError> {
        let files: Vec<_> = (1..parts).map(|part| self.part_file(number, part, parts)).collect();
        if !files.iter().all(|path| path.exists()) {
            return Ok(None);
        }
        let mut tiles = Vec::new();
        for path in &files {
            let bytes = fs::read(path).map_err(|e| StageError::file(path, e))?;
            let read = bytes.chunks(PART_TILE_BYTES).map(part_tile).collect::<Option<Vec<_>>>();
            tiles.extend(read.ok_or_else(|| StageError::file(path, "not a part of a submap"))?);
        }
        Ok(Some(tiles))
    }

    /// Removes parts of submaps with numbers below this.
    pub fn remove_parts(&self, below: u32) {
        let Ok(entries) = fs::read_dir(self.directory.join(PARTS)) else { return };
        for path in entries.flatten().map(|entry| entry.path()) {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
            let number = name.and_then(|name| name.split('.').next()?.parse::<u32>().ok());
            if number.is_some_and(|number| number < below) {
                // What cannot be removed is tried again with the next submap.
                let _ = fs::remove_file(path);
            }
        }
    }

    fn part_file(&self, number: u32, part: u32, parts: u32) -> PathBuf {
        self.directory.join(PARTS).join(format!("{number:06}.{part}-of-{parts}"))
    }

    /// Bytes of all stored submaps.
    pub fn bytes(&self) -> u64 {
        let size = |number| fs::metadata(self.file(number)).map_or(0, |file| file.len());
        (0..self.count()).map(size).sum()
    }

    /// How many submaps there are: they are numbered from 0 without gaps.
    pub fn count(&self) -> u32 {
        (0..).find(|number| !self.file(*number).exists()).expect("a directory is finite")
    }

    /// The file of the submap of this number.
    pub fn file(&self, number: u32) -> PathBuf {
        self.directory.join(format!("{number:06}.{ENDING}"))
    }
}

/// A tile of a part: its key and its cells.
const PART_TILE_BYTES: usize = size_of::<TileKey>() + size_of::<[PackedCell; TILE_CELLS]>();

fn part_tile(bytes: &[u8]) -> Option<SubmapTile> {
    let (key, cells) = TileKey::read_from_prefix(bytes).ok()?;
    let cells = <[PackedCell; TILE_CELLS]>::read_from_bytes(cells).ok()?;
    Some(SubmapTile::new(key, Box::new(cells)))
}

fn checksum(bytes: &[u8]) -> u64 {
    // FNV-1a: tells versions apart; damage is found by the check inside the file.
    bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_geometry::Pose;

    #[test]
    fn parts_come_back_as_they_were_once_all_are_there() {
        let directory = tempfile::tempdir().unwrap();
        let store = SubmapStore::new(directory.path());
        let tile = |x: i32| {
            let mut cells = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
            (0..TILE_CELLS)
                .for_each(|at| cells[at] = PackedCell { occupied: at as u16, free: 7 * at as u16 });
            SubmapTile::new(TileKey { x, y: -x }, cells)
        };
        let submap = |x| Submap {
            number: 4,
            chain: 0,
            insertions: 1,
            first: 0,
            last: 0,
            odom_from_submap: Pose::IDENTITY,
            cell_size_m: 0.05,
            tiles: vec![tile(x), tile(x + 10)],
        };
        store.save_part(&submap(2), 2, 3).unwrap();
        assert!(store.load_parts(4, 3).unwrap().is_none());
        store.save_part(&submap(1), 1, 3).unwrap();
        let tiles = store.load_parts(4, 3).unwrap().unwrap();
        assert_eq!(tiles, [tile(1), tile(11), tile(2), tile(12)]);
        assert_eq!(store.count(), 0, "a part is no submap");
        store.remove_parts(4);
        assert!(store.load_parts(4, 3).unwrap().is_some());
        store.remove_parts(5);
        assert!(store.load_parts(4, 3).unwrap().is_none());
    }
}
