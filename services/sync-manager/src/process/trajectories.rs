//! The files of poses: online poses as they come, frozen scans, and at the end the final trajectory of all scans.

use crate::{FrozenScan, Solution};
use flockslam_geometry::Pose;
use flockslam_messages::PoseEstimate;
use flockslam_results::flock_files::NamedPose;
use flockslam_results::{self as results, StampedPose};
use flockslam_stage::{GrowingFile, StageError};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Data that grows with every scan and is needed only at the end. It is kept in files, not in memory.
pub struct Trajectories {
    directory: PathBuf,
    online: RowFile<StampedPose>,
    frozen: RowFile<FrozenRow>,
}

/// A frozen scan as it is stored.
#[repr(C)]
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
struct FrozenRow {
    sequence: u64,
    stamp_ns: i64,
    anchor: u64,
    anchor_from_base: Pose,
}

impl Trajectories {
    /// Empty ones, in a directory that exists.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn create(directory: &Path) -> Result<Self, StageError> {
        Ok(Self {
            directory: directory.to_owned(),
            online: RowFile::create(directory.join("online.rows"))?,
            frozen: RowFile::create(directory.join("frozen.rows"))?,
        })
    }

    /// Goes on in another directory, and replaces the files there.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn move_to(&mut self, directory: &Path) -> Result<(), StageError> {
        self.directory = directory.to_owned();
        self.online.move_to(directory)?;
        self.frozen.move_to(directory)
    }

    /// Begins anew in the same directory.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn begin_anew(&mut self) -> Result<(), StageError> {
        *self = Self::create(&self.directory)?;
        Ok(())
    }

    /// Adds a pose as it was published.
    pub fn published(&mut self, pose: &PoseEstimate) {
        self.online.push(&StampedPose { stamp_ns: pose.times.sensor_ns, pose: pose.map_from_base() });
    }

    /// Keeps scans that are frozen.
    pub fn frozen(&mut self, scans: &[FrozenScan]) {
        for scan in scans {
            let FrozenScan { id, stamp_ns, anchor, anchor_from_base } = *scan;
            self.frozen.push(&FrozenRow { sequence: id.sequence, stamp_ns, anchor, anchor_from_base });
        }
    }

    /// Writes the published trajectory, and the final one in the order of the scans, which it gives by their names.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn finish(&mut self, solution: &Solution) -> Result<Vec<NamedPose>, StageError> {
        results::write_trajectory(&self.directory, results::ONLINE_TRAJECTORY, self.online.read()?)?;
        let rows = self.placed(solution)?;
        let stamped = |row: &NamedPose| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose };
        results::write_trajectory(
            &self.directory,
            results::FINAL_TRAJECTORY,
            rows.iter().map(stamped).map(Ok),
        )?;
        Ok(rows)
    }

    /// All scans, frozen ones and others, in the order of their sequences.
    fn placed(&mut self, solution: &Solution) -> Result<Vec<NamedPose>, StageError> {
        let mut rows = Vec::with_capacity(self.frozen.count() + solution.trajectory.len());
        let mut through_frozen = Vec::new();
        let path = self.frozen.file.path().to_owned();
        for frozen in self.frozen.read()? {
            let frozen = frozen.map_err(|error| StageError::file(&path, error))?;
            match solution.anchor(frozen.anchor) {
                Some(anchor) => rows.push(frozen.placed(anchor)),
                None => through_frozen.push(frozen),
            }
        }
        rows.sort_unstable_by_key(|row| row.sequence);
        // A localized scan may be anchored at a node whose own scan has frozen since.
        let anchor = |frozen: &FrozenRow| {
            let place = rows.binary_search_by_key(&frozen.anchor, |row| row.sequence);
            rows[place.expect("anchors stay, or their own scans are frozen")].pose
        };
        let placed: Vec<_> = through_frozen.iter().map(|frozen| frozen.placed(anchor(frozen))).collect();
        rows.extend(placed);
        rows.extend(solution.trajectory.iter().map(|placed| NamedPose {
            sequence: placed.id.sequence,
            stamp_ns: placed.stamp_ns,
            pose: placed.map_from_base,
        }));
        // Scans of the map freeze later than those after them that the set has localized with.
        rows.sort_unstable_by_key(|row| row.sequence);
        Ok(rows)
    }
}

impl FrozenRow {
    /// Where the scan is when its anchor is there.
    fn placed(&self, anchor: Pose) -> NamedPose {
        let (sequence, stamp_ns) = (self.sequence, self.stamp_ns);
        NamedPose { sequence, stamp_ns, pose: anchor * self.anchor_from_base }
    }
}

/// Rows of one kind, appended to a file.
struct RowFile<T> {
    file: GrowingFile,
    rows: std::marker::PhantomData<T>,
}

impl<T: FromBytes + IntoBytes + Immutable> RowFile<T> {
    fn create(path: PathBuf) -> Result<Self, StageError> {
        Ok(Self { file: GrowingFile::create(path)?, rows: std::marker::PhantomData })
    }

    fn move_to(&mut self, directory: &Path) -> Result<(), StageError> {
        let to = directory.join(self.file.path().file_name().expect("a file of rows has a name"));
        Ok(self.file.rename(to)?)
    }

    fn push(&mut self, row: &T) {
        self.file.push(row.as_bytes());
    }

    /// Number of rows.
    fn count(&self) -> usize {
        self.file.bytes() as usize / size_of::<T>()
    }

    /// The rows, read one after the other.
    fn read(&mut self) -> Result<impl Iterator<Item = io::Result<T>> + use<T>, StageError> {
        self.file.flush()?;
        let file = File::open(self.file.path()).map_err(|e| StageError::file(self.file.path(), e))?;
        let mut file = BufReader::new(file);
        let mut row = vec![0; size_of::<T>()];
        let mut read = move || {
            file.read_exact(&mut row)?;
            T::read_from_bytes(&row).map_err(|_| io::Error::other("a torn row"))
        };
        Ok((0..self.count()).map(move |_| read()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MAP_ANCHOR, PlacedScan};
    use flockslam_messages::ScanId;

    #[test]
    fn a_localized_scan_moves_with_its_node_also_when_that_has_frozen() {
        let directory = tempfile::tempdir().unwrap();
        let mut trajectories = Trajectories::create(directory.path()).unwrap();
        let frozen = |sequence: u64, anchor: u64| FrozenScan {
            id: ScanId { sequence, ..ScanId::default() },
            stamp_ns: sequence as i64,
            anchor,
            anchor_from_base: Pose::new(1.0, 0.0, 0.0),
        };
        trajectories.frozen(&[frozen(8, 0), frozen(9, 3), frozen(10, MAP_ANCHOR), frozen(3, 0)]);
        let anchors = vec![(0, Pose::new(0.0, 2.0, 0.0))];
        let poses = trajectories.finish(&Solution { anchors, ..Solution::default() }).unwrap();
        let found: Vec<_> = poses.iter().map(|row| (row.sequence, row.pose.x_m, row.pose.y_m)).collect();
        assert_eq!(found, [(3, 1.0, 2.0), (8, 1.0, 2.0), (9, 2.0, 2.0), (10, 1.0, 0.0)]);
    }

    #[test]
    fn frozen_scans_take_their_places_among_the_others() {
        let directory = tempfile::tempdir().unwrap();
        let mut trajectories = Trajectories::create(directory.path()).unwrap();
        let id = |sequence| ScanId { sequence, ..ScanId::default() };
        for sequence in 0..5 {
            let mut pose = PoseEstimate { id: id(sequence), ..PoseEstimate::default() };
            pose.times.sensor_ns = sequence as i64;
            trajectories.published(&pose);
        }
        let freeze = |sequence: u64| FrozenScan {
            id: id(sequence),
            stamp_ns: sequence as i64,
            anchor: 0,
            anchor_from_base: Pose::new(sequence as f64, 0.0, 0.0),
        };
        trajectories.frozen(&[freeze(1), freeze(3)]);
        let place = |sequence: u64| PlacedScan {
            id: id(sequence),
            stamp_ns: sequence as i64,
            map_from_base: Pose::new(sequence as f64, 2.0, 0.0),
        };
        let solution = Solution {
            trajectory: vec![place(0), place(2), place(4)],
            anchors: vec![(0, Pose::new(0.0, 2.0, 0.0))],
            ..Solution::default()
        };
        trajectories.finish(&solution).unwrap();
        let read = |name| results::read_trajectory(directory.path(), name).unwrap();
        let last = read(results::FINAL_TRAJECTORY);
        assert!(last.iter().enumerate().all(|(i, row)| row.stamp_ns == i as i64));
        assert!(last.iter().enumerate().all(|(i, row)| row.pose == Pose::new(i as f64, 2.0, 0.0)));
        assert_eq!((last.len(), read(results::ONLINE_TRAJECTORY).len()), (5, 5));
    }
}
