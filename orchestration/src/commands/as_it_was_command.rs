//! `flockslam map RECORDING --as-it-was`: the poses that a recorded set published, computed again.

use super::run::prepare_directory;
use super::{CommandError, print};
use crate::as_it_was::{BlackBox, run_as_it_was};
use crate::outputs::{TrajectoryPoint, write_trajectory};
use std::path::Path;

/// Runs the recording again and writes the poses.
///
/// # Errors
/// When it is none of a set, or the outputs cannot be written; and when the poses are not those that were published.
pub fn run(recording: &Path, out: &Path) -> Result<(), CommandError> {
    let recorded = BlackBox::read(recording).map_err(CommandError::user)?;
    prepare_directory(out)?;
    let (poses, comparison) = run_as_it_was(&recorded);
    let point = |pose: &flockslam_messages::PoseEstimate| TrajectoryPoint {
        stamp_ns: pose.times.sensor_ns,
        map_from_base: pose.map_from_base(),
    };
    let points: Vec<_> = poses.iter().map(point).collect();
    write_trajectory(&out.join("trajectory_online.tum"), &points).map_err(CommandError::failed)?;
    let json = serde_json::to_vec_pretty(&comparison).map_err(CommandError::failed)?;
    let durability = flockslam_journal::Durability::Process;
    flockslam_journal::replace_file(&out.join("as_it_was.json"), &json, durability)
        .map_err(CommandError::failed)?;
    print(&comparison.to_string());
    print(&format!("wrote trajectory_online.tum, as_it_was.json to {}\n", out.display()));
    if comparison.is_exact() {
        print("exact: every pose is the published one\n");
        return Ok(());
    }
    Err(CommandError::failed(format!("{}: not exact", recording.display())))
}
