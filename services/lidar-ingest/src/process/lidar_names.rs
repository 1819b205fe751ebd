//! Numbers of lidars by their names. Takes names as they come; gives the same numbers after a restart.

use flockslam_stage::StageError;
use std::fs;
use std::path::{Path, PathBuf};

/// Lidars of one robot.
const LIDARS_MAX: usize = 16;
/// The file in the status directory of the set: a name a line.
const FILE: &str = "lidars";

/// Names of the lidars of a robot, by number.
#[derive(Debug)]
pub struct LidarNames {
    names: Vec<String>,
    /// Only those that were named beforehand are known.
    is_fixed: bool,
    file: PathBuf,
}

/// A scan of a lidar that is not known.
#[derive(Debug, thiserror::Error)]
pub enum UnknownLidar {
    /// Those that are read are named.
    #[error("lidar '{0}' is not among lidar_ingest.scan_topics: its scans are left out, counted")]
    NotNamed(String),
    /// Too many.
    #[error("lidar '{0}' is one more than {LIDARS_MAX}: its scans are left out, counted")]
    TooMany(String),
}

impl LidarNames {
    /// The names that settings give, else those that came so far in the set with this status directory.
    pub fn open(status_dir: &Path, named: &[String]) -> Result<Self, StageError> {
        let file = status_dir.join(FILE);
        let is_fixed = !named.is_empty();
        let names = if is_fixed { named.to_vec() } else { read(&file) };
        let names = Self { names, is_fixed, file };
        names.store()?;
        Ok(names)
    }

    /// The number of a lidar; a new one gets the next.
    pub fn number(&mut self, name: &str) -> Result<u32, UnknownLidar> {
        if let Some(number) = self.names.iter().position(|known| known == name) {
            return Ok(number as u32);
        }
        if self.is_fixed {
            return Err(UnknownLidar::NotNamed(name.to_owned()));
        }
        if self.names.len() == LIDARS_MAX {
            return Err(UnknownLidar::TooMany(name.to_owned()));
        }
        self.names.push(name.to_owned());
        if let Err(error) = self.store() {
            tracing::warn!(%error, "the numbers of lidars may change with a restart");
        }
        Ok(self.names.len() as u32 - 1)
    }

    /// How many are known.
    pub fn count(&self) -> usize {
        self.names.len()
    }

    /// The name of a lidar.
    pub fn name(&self, number: u32) -> String {
        self.names.get(number as usize).cloned().unwrap_or_default()
    }

    fn store(&self) -> Result<(), StageError> {
        if self.names.is_empty() {
            return Ok(());
        }
        let text: String = self.names.iter().flat_map(|name| [name.as_str(), "\n"]).collect();
        fs::write(&self.file, text).map_err(|error| StageError::file(&self.file, error))
    }
}

/// The names of the lidars of a set, by number.
pub fn read_lidar_names(status_dir: &Path) -> Vec<String> {
    read(&status_dir.join(FILE))
}

fn read(file: &Path) -> Vec<String> {
    let text = fs::read_to_string(file).unwrap_or_default();
    text.lines().take(LIDARS_MAX).map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lidar_keeps_its_number() {
        let directory = tempfile::tempdir().unwrap();
        let mut names = LidarNames::open(directory.path(), &[]).unwrap();
        let numbers = ["rear", "front", "rear", ""].map(|name| names.number(name).unwrap());
        assert_eq!(numbers, [0, 1, 0, 2]);
        let mut names = LidarNames::open(directory.path(), &[]).unwrap();
        assert_eq!((names.number("front").unwrap(), names.number("").unwrap(), names.count()), (1, 2, 3));
        for number in 3..LIDARS_MAX {
            names.number(&number.to_string()).unwrap();
        }
        assert!(matches!(names.number("one more"), Err(UnknownLidar::TooMany(_))));
        let mut named = LidarNames::open(directory.path(), &["front".to_owned()]).unwrap();
        assert_eq!(named.number("front").unwrap(), 0);
        assert!(matches!(named.number("rear"), Err(UnknownLidar::NotNamed(_))));
        assert_eq!(read_lidar_names(directory.path()), ["front"]);
    }
}
