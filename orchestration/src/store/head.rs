//! `map.head`: the record that says which build and which settings a saved map belongs to.

use super::StoreError;
use flockslam_journal::{Ending, RecordReader, RecordWriter};
use flockslam_messages::{Layout, Message, PoseEstimate, ScanHeader};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

/// Version of the arrangement of a saved map.
pub const FORMAT: u32 = 1;
const FILE: &str = "map.head";
const RECORD: u32 = 1;

/// Arrangements that differ in the names of fields alone, each with the one that is the same to the byte.
const SAME_BYTES: [(&str, &str); 2] = [
    ("flockslam/pose/v2 6852d672b9c25794", "flockslam/pose/v2 bd7606bfaa7d0ec1"),
    ("flockslam/scan/v1 5dbb5a657846ba40", "flockslam/scan/v1 257b13703682a316"),
];

/// What a saved map says of itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapHead {
    /// Version of the arrangement.
    pub format: u32,
    /// Version of flockslam that began it.
    pub version: String,
    /// Name of the robot.
    pub robot: String,
    /// Message type and layout of the poses in the journal.
    pub poses: String,
    /// The same of the scans.
    pub scans: String,
    /// Side of a cell, metres: evidence of different cells cannot be brought together.
    pub cell_size_m: f64,
}

impl MapHead {
    /// The head of a map that this build begins.
    pub fn of_this_build(robot: &str, cell_size_m: f64) -> Self {
        Self {
            format: FORMAT,
            version: crate::VERSION.to_owned(),
            robot: robot.to_owned(),
            poses: layout_of::<PoseEstimate>(),
            scans: layout_of::<ScanHeader>(),
            cell_size_m,
        }
    }

    /// Reads the head of the map in a directory.
    ///
    /// # Errors
    /// When there is no map, or its head is damaged or of an arrangement that this build does not know.
    pub fn read(directory: &Path) -> Result<Self, StoreError> {
        let path = directory.join(FILE);
        if !path.exists() {
            return Err(StoreError::Absent(directory.to_owned()));
        }
        let wrong = |reason: &str| StoreError::Head { path: path.clone(), reason: reason.to_owned() };
        let mut records = RecordReader::open(&path)?;
        let record = records.next_record()?.filter(|record| record.kind == RECORD);
        let head = record.and_then(|record| serde_json::from_slice::<Self>(record.payload).ok());
        let head = head.ok_or_else(|| wrong("the head of the map is damaged"))?;
        if records.next_record()?.is_some() || records.ending() != Ending::Clean {
            return Err(wrong("something follows the head of the map"));
        }
        if head.format != FORMAT {
            let known = format!("a map of format {}, this build reads format {FORMAT}", head.format);
            return Err(wrong(&known));
        }
        Ok(head)
    }

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, directory: &Path) -> Result<(), StoreError> {
        let (path, partial) = (directory.join(FILE), directory.join("map.head.partial"));
        let json = serde_json::to_vec(self).expect("a head can be written as JSON");
        let mut records = RecordWriter::create(&partial)?;
        records.append(RECORD, &[&json])?;
        records.sync()?;
        fs::rename(&partial, &path).map_err(StoreError::io(&path))?;
        fs::File::open(directory).and_then(|d| d.sync_all()).map_err(StoreError::io(directory))
    }

    /// Whether evidence and journal of this map can be used by what `wanted` describes.
    ///
    /// # Errors
    /// When they cannot: what differs.
    pub fn fits(&self, directory: &Path, wanted: &Self) -> Result<(), StoreError> {
        let cell = |head: &Self| head.cell_size_m.to_string();
        let keys = [
            ("poses", renamed(&self.poses), wanted.poses.clone()),
            ("scans", renamed(&self.scans), wanted.scans.clone()),
            ("mapper.cell_size_m", cell(self), cell(wanted)),
        ];
        match keys.into_iter().find(|(_, found, wanted)| found != wanted) {
            Some((key, found, wanted)) => {
                Err(StoreError::Mismatch { path: directory.to_owned(), key, found, wanted })
            }
            None => Ok(()),
        }
    }
}

/// The arrangement by the names that its fields have now.
fn renamed(arrangement: &str) -> String {
    let now = SAME_BYTES.iter().find(|(before, _)| *before == arrangement).map(|(_, now)| now);
    (*now.unwrap_or(&arrangement)).to_owned()
}

fn layout_of<M: Message + Layout>() -> String {
    format!("{} {:016x}", M::TYPE_NAME, M::HASH)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_comes_back_and_no_flipped_bit_or_cut_is_accepted() {
        let directory = tempfile::tempdir().unwrap();
        let head = MapHead::of_this_build("r1", 0.045);
        assert!(matches!(MapHead::read(directory.path()), Err(StoreError::Absent(_))));
        head.write(directory.path()).unwrap();
        assert_eq!(MapHead::read(directory.path()).unwrap(), head);
        let path = directory.path().join(FILE);
        let bytes = fs::read(&path).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, damaged).unwrap();
            assert!(MapHead::read(directory.path()).is_err(), "bit {bit}");
        }
        for length in 0..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            assert!(MapHead::read(directory.path()).is_err(), "{length} bytes");
        }
    }

    #[test]
    fn a_map_from_before_its_fields_were_renamed_fits() {
        let now = MapHead::of_this_build("r1", 0.045);
        let [(poses, _), (scans, _)] = SAME_BYTES.map(|(before, now)| (before.to_owned(), now));
        let before = MapHead { poses, scans, ..now.clone() };
        assert!(before.fits(Path::new("maps/r1"), &now).is_ok(), "{now:?}");
        let other = MapHead { poses: "flockslam/pose/v2 0000000000000000".to_owned(), ..now.clone() };
        assert!(other.fits(Path::new("maps/r1"), &now).is_err());
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let (coarse, fine) = (MapHead::of_this_build("r1", 0.1), MapHead::of_this_build("r1", 0.045));
        assert!(coarse.fits(Path::new("maps/r1"), &coarse).is_ok());
        let text = coarse.fits(Path::new("maps/r1"), &fine).unwrap_err().to_string();
        assert!(text.contains("mapper.cell_size_m = 0.1"), "{text}");
    }
}
