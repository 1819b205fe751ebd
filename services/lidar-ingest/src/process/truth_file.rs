//! Writes the exact trajectory of a simulated drive beside the results.

use flockslam_geometry::Pose;
use flockslam_results::{StampedPose, TRUE_TRAJECTORY};
use flockslam_stage::{GrowingFile, StageError};
use std::path::{Path, PathBuf};
use zerocopy::IntoBytes;

/// The exact trajectory of a simulated robot, written pose by pose: a drive of any length takes no more memory.
#[derive(Debug)]
pub struct TruthWriter {
    file: GrowingFile,
    whole: PathBuf,
}

impl TruthWriter {
    /// Restarts the trajectory, under the name of an incomplete file.
    pub fn create(result_dir: &Path) -> Result<Self, StageError> {
        let whole = result_dir.join(TRUE_TRAJECTORY);
        Ok(Self { file: GrowingFile::create(whole.with_extension("growing"))?, whole })
    }

    /// Appends a pose.
    pub fn push(&mut self, stamp_ns: i64, pose: Pose) {
        self.file.push(StampedPose { stamp_ns, pose }.as_bytes());
    }

    /// The drive is over: gives the trajectory its name.
    pub fn finish(&mut self) -> Result<(), StageError> {
        self.file.flush()?;
        Ok(self.file.rename(self.whole.clone())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_results::read_trajectory;

    #[test]
    fn a_trajectory_has_its_name_once_it_is_whole() {
        let directory = tempfile::tempdir().unwrap();
        let mut truth = TruthWriter::create(directory.path()).unwrap();
        let pose = |i: i64| Pose::new(i as f64, 1.0, 0.5);
        (0..1000).for_each(|i| truth.push(i, pose(i)));
        assert!(read_trajectory(directory.path(), TRUE_TRAJECTORY).is_err());
        truth.finish().unwrap();
        let rows = read_trajectory(directory.path(), TRUE_TRAJECTORY).unwrap();
        assert_eq!((rows.len(), rows[999].stamp_ns, rows[999].pose), (1000, 999, pose(999)));
    }
}
