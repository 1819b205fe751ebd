//! The files of poses: online poses as they come, frozen scans, and at the end the final trajectory of all scans.

use crate::{FrozenScan, Solution};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, ScanId};
use flockslam_results::flock_files::NamedPose;
use flockslam_results::{self as results, StampedPose};
use flockslam_stage::{GrowingFile, StageError};
use std::fs::File;
use std::io::{BufReader, Read};
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

    /// Adds a pose as it was published.
    pub fn published(&mut self, pose: &PoseEstimate) {
        self.online.push(&StampedPose { stamp_ns: pose.times.sensor_ns, pose: pose.map_from_base() });
    }

    /// Keeps scans that are frozen, in the order of their sequences.
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
        results::write_trajectory(&self.directory, results::ONLINE_TRAJECTORY, &self.online.read()?)?;
        let row = |placed: &crate::PlacedScan| NamedPose {
            sequence: placed.id.sequence,
            stamp_ns: placed.stamp_ns,
            pose: placed.map_from_base,
        };
        let mut live = solution.trajectory.iter().peekable();
        let mut rows = Vec::new();
        for frozen in self.frozen.read()? {
            while let Some(placed) = live.next_if(|placed| placed.id.sequence < frozen.sequence) {
                rows.push(row(placed));
            }
            rows.push(row(&solution.frozen(&frozen.scan())));
        }
        rows.extend(live.map(row));
        let stamped = |row: &NamedPose| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose };
        let stamped: Vec<_> = rows.iter().map(stamped).collect();
        results::write_trajectory(&self.directory, results::FINAL_TRAJECTORY, &stamped)?;
        Ok(rows)
    }
}

impl FrozenRow {
    fn scan(&self) -> FrozenScan {
        let id = ScanId { sequence: self.sequence, ..ScanId::default() };
        let Self { stamp_ns, anchor, anchor_from_base, .. } = *self;
        FrozenScan { id, stamp_ns, anchor, anchor_from_base }
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

    fn read(&mut self) -> Result<Vec<T>, StageError> {
        self.file.flush()?;
        let wrong = |e| StageError::file(self.file.path(), e);
        let file = File::open(self.file.path()).map_err(wrong)?;
        let rows = file.metadata().map_err(wrong)?.len() as usize / size_of::<T>();
        let mut file = BufReader::new(file);
        let mut row = vec![0; size_of::<T>()];
        let mut read = || {
            file.read_exact(&mut row)?;
            T::read_from_bytes(&row).map_err(|_| std::io::Error::other("a torn row"))
        };
        (0..rows).map(|_| read().map_err(wrong)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PlacedScan;

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
