//! What a run leaves in its directory: trajectories, map, picture, report. Each is rendered to bytes by a pure
//! function and put in place atomically, so nothing half-written ever looks whole.

mod calibration_row;
mod canvas;
mod glyphs;
mod map_files;
mod map_hash;
mod occupancy;
mod picture;
mod run_report;
mod tum_text;

pub use calibration_row::CalibrationRow;
pub use flockslam_evidence::CellState;
pub use map_files::{render_pgm, render_yaml, write_map};
pub use map_hash::{MapHasher, map_hash};
pub use occupancy::OccupancyImage;
pub use picture::{PictureTracks, render_picture, write_flock_picture, write_picture};
pub use run_report::{LatencyMicroseconds, LoopClosures, ProcessUse, Report, StageReport, write_report};
pub use tum_text::{TrajectoryPoint, render_trajectory, write_trajectory};

use flockslam_journal::{Durability, JournalError, replace_file, replace_file_by};
use std::fs::File;
use std::io;
use std::path::Path;

/// Why an output could not be written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The disk refused.
    #[error(transparent)]
    Write(#[from] JournalError),
    /// The picture could not be encoded.
    #[error("cannot encode the picture of the map: {0}")]
    Picture(#[from] png::EncodingError),
    /// The report could not be encoded.
    #[error("cannot encode the report: {0}")]
    Report(#[from] serde_json::Error),
}

fn put(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    Ok(replace_file(path, bytes, Durability::Process)?)
}

/// As [`put`], for what is written piece by piece.
fn put_by(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> Result<(), OutputError> {
    Ok(replace_file_by(path, write, Durability::Process)?)
}
