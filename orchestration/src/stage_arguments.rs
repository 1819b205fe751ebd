//! The arguments of `flockslam stage`.

use crate::supervisor::known_stage;
use clap::Args;
use flockslam_messages::Stage;
use std::path::PathBuf;

/// `flockslam stage`.
#[derive(Clone, Debug, Args)]
pub struct StageArgs {
    /// Which stage
    #[arg(value_parser = known_stage)]
    pub stage: Stage,
    /// Directory of the running set
    #[arg(long, value_name = "DIR")]
    pub set_dir: PathBuf,
    /// Which replica
    #[arg(long, default_value_t = 0)]
    pub replica: u32,
    /// Process to die with
    #[arg(long)]
    pub parent: Option<u32>,
    /// Run what stands in for the stage when it does not get up
    #[arg(long)]
    pub fallback: bool,
}
