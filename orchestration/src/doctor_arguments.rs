//! The arguments of `flockslam doctor`.

use crate::arguments::RobotArgs;
use clap::Args;
use std::path::PathBuf;

/// `flockslam doctor`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Exit code: 0 nothing to do, 3 warnings, 4 errors; 1 and 2 when the command itself fails."
)]
pub struct DoctorArgs {
    /// Description of a process set (TOML) to look at, whether the set runs or not; without it the sets that run are looked at
    #[arg(value_name = "SET.toml", conflicts_with = "robot")]
    pub set: Option<PathBuf>,
    /// Which running set
    #[command(flatten)]
    pub robot: RobotArgs,
    /// Prints JSON: findings, and the readings that they come from
    #[arg(long)]
    pub json: bool,
    /// Packs logs, metrics, configuration, the last three minutes of the journal and a picture of the map for a bug report;
    /// keys and tokens stay out
    #[arg(long, value_name = "FILE.tar.gz")]
    pub bundle: Option<PathBuf>,
}
