//! The files of poses: online poses as they come, frozen scans, and at the end the final trajectory of all scans.

use crate::{FrozenScan, Solution};
use flockslam_geometry::Pose;
use flockslam_messages::PoseEstimate;
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
        results::write_trajectory(&self.directory, results::ONLINE_TRAJECTORY, &self.online.read()?)?;
        let row = |placed: &crate::PlacedScan| NamedPose {
            sequence: placed.id.sequence,
            stamp_ns: placed.stamp_ns,
            pose: placed.map_from_base,
        };
        let mut live = solution.trajectory.iter().peekable();
        let mut rows = Vec::new();
        let mut frozen_rows = self.frozen.read()?;
        // Scans of the map freeze later than those after them that the set has localized with.
        frozen_rows.sort_by_key(|row| row.sequence);
        let pose = |row: &FrozenRow| Some(solution.anchor(row.anchor)? * row.anchor_from_base);
        // A localized scan may be anchored at a node whose own scan has frozen since.
        let through_frozen = |row: &FrozenRow| {
            let place = frozen_rows.binary_search_by_key(&row.anchor, |other| other.sequence).ok()?;
            Some(pose(&frozen_rows[place])? * row.anchor_from_base)
        };
        for frozen in &frozen_rows {
            while let Some(placed) = live.next_if(|placed| placed.id.sequence < frozen.sequence) {
                rows.push(row(placed));
            }
            let pose = pose(frozen).or_else(|| through_frozen(frozen));
            let pose = pose.expect("anchors stay, or their own scans are frozen");
            rows.push(NamedPose { sequence: frozen.sequence, stamp_ns: frozen.stamp_ns, pose });
        }
        rows.extend(live.map(row));
        let stamped = |row: &NamedPose| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose };
        let stamped: Vec<_> = rows.iter().map(stamped).collect();
        results::write_trajectory(&self.directory, results::FINAL_TRAJECTORY, &stamped)?;
        Ok(rows)
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
