//! What a run leaves as files, and what others read of it: trajectories, the fused map, the summary, closed submaps, and what a robot of a flock keeps.

pub mod flock_files;
mod flock_status;
mod results_error;
mod run_results;
mod submap_store;

pub use flock_status::FlockStatus;
pub use results_error::ResultsError;
pub use run_results::{
    FINAL_TRAJECTORY, FUSED_MAP, LivePoses, ONLINE_TRAJECTORY, SUMMARY, StampedPose, StoredMap, SubmapRow,
    Summary, TRUE_TRAJECTORY, live_poses_file, read_live_poses, read_map, read_summary, read_trajectory,
    write_live_poses, write_map, write_summary, write_trajectory,
};
pub use submap_store::SubmapStore;
