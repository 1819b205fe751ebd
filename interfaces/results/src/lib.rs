//! What a run leaves as files, and what others read of it: trajectories, the fused map, the summary, closed submaps, and what a robot of a flock keeps.

pub mod flock_files;
mod flock_status;
mod lidar_status;
mod localisation_status;
mod results_error;
mod run_results;
mod set_mode;
mod stored_map;
mod submap_store;
mod unattached;

pub use flock_status::FlockStatus;
pub use lidar_status::LidarStatus;
pub use localisation_status::{HypothesisRow, LocalisationStatus, LocalisationSummary};
pub use results_error::ResultsError;
pub use run_results::{
    DetachedRow, FINAL_TRAJECTORY, LivePoses, ONLINE_TRAJECTORY, SUMMARY, StampedPose, SubmapRow, Summary,
    TRUE_TRAJECTORY, live_poses_file, read_live_poses, read_summary, read_trajectory, write_live_poses,
    write_summary, write_trajectory,
};
pub use set_mode::{ModeWatch, SetMode};
pub use stored_map::{
    FUSED_MAP, KNOWN_MAP, MapReader, MapShape, StoredMap, read_map, write_map, write_map_file, write_map_rows,
};
pub use submap_store::SubmapStore;
pub use unattached::Unattached;
