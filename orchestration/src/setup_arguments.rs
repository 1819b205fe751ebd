//! The arguments of `flockslam setup`.

use crate::lidar_arguments::family;
use crate::setup::{Mounting, SetupMode, set_name};
use clap::{Args, ValueEnum};
use flockslam_lidars::Family;
use std::path::PathBuf;

/// `flockslam setup`. What is not given is asked for in the terminal; without one all of it has to be given.
#[derive(Clone, Debug, Args)]
pub struct SetupArgs {
    /// Serial port of the lidar; without it ports on USB are searched
    #[arg(long, value_name = "PORT", conflicts_with = "address")]
    pub port: Option<PathBuf>,
    /// Host of the lidar, with its TCP port where that is another than usual
    #[arg(long, value_name = "HOST[:PORT]")]
    pub address: Option<String>,
    /// Family of the lidar: ld06, rplidar, ydlidar, urg, sick-tim; found out when it is not given
    #[arg(long, value_name = "KIND", value_parser = family)]
    pub kind: Option<Family>,
    /// The rate of its serial line, bits a second; found out when it is not given
    #[arg(long, value_name = "BAUD")]
    pub baud: Option<u32>,
    /// Its model, where it does not say it itself
    #[arg(long, value_name = "MODEL")]
    pub model: Option<String>,
    /// Where it sits: metres ahead and to the left of the middle of the robot, degrees counter-clockwise
    #[arg(long, value_name = "X_M,Y_M,HEADING_DEG", allow_hyphen_values = true)]
    pub mounting: Option<Mounting>,
    /// It hangs upside down
    #[arg(long)]
    pub upside_down: bool,
    /// Name of the robot: letters, digits and `-`, at most 22
    #[arg(long, value_name = "NAME", value_parser = set_name)]
    pub robot: Option<String>,
    /// Make a map, or find the robot in a known one
    #[arg(long, value_enum)]
    pub mode: Option<SetupMode>,
    /// Where the map is kept, or the map that is known
    #[arg(long, value_name = "DIR")]
    pub map: Option<PathBuf>,
    /// Whether the set becomes a node of a ROS 2 graph
    #[arg(long, value_enum, value_name = "yes|no")]
    pub ros: Option<YesNo>,
    /// One setting more, written into the description, for example --set page.enabled=false; may be given many times
    #[arg(long = "set", value_name = "SECTION.KEY=VALUE")]
    pub assignments: Vec<String>,
    /// Description to write
    #[arg(long, value_name = "SET.toml")]
    pub out: Option<PathBuf>,
    /// Overwrites a description that is there
    #[arg(long)]
    pub force: bool,
    /// Whether the set is started; it then runs until it is stopped
    #[arg(long, value_enum, value_name = "yes|no")]
    pub start: Option<YesNo>,
}

/// An answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum YesNo {
    /// Yes.
    Yes,
    /// No.
    No,
}
