//! The arguments of `flockslam manuals`.

use clap::Args;
use std::path::PathBuf;

/// `flockslam manuals`.
#[derive(Clone, Debug, Args)]
pub struct ManualsArgs {
    /// Directory for `man1/` and `completions/`; made when it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}
