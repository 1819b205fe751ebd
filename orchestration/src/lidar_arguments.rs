//! The arguments of `flockslam lidar`.

use crate::arguments::RobotArgs;
use crate::supervisor::LidarLine;
use clap::{Args, Subcommand};
use flockslam_lidars::Family;
use std::path::PathBuf;

/// `flockslam lidar`.
#[derive(Clone, Debug, Subcommand)]
pub enum LidarCommand {
    /// Lists serial ports, and which lidar answers at each
    List(LidarListArgs),
    /// Draws the scans of a lidar, or of a running set, live in the terminal
    Watch(LidarWatchArgs),
    /// Learns where lidars see their own robot, while it drives or turns, and prints the setting that hides it
    LearnMask(LearnMaskArgs),
    /// Says where the lidars of a running set sit, and how far their stamps are off, by the drive so far
    Calibrate(RobotArgs),
}

/// `flockslam lidar list`.
#[derive(Clone, Debug, Args)]
pub struct LidarListArgs {
    /// A serial port to look at, in place of all on USB; may be given many times
    #[arg(long, value_name = "PORT")]
    pub port: Vec<PathBuf>,
    /// A host, with its TCP port where that is another than usual, to look at; may be given many times
    #[arg(long, value_name = "HOST[:PORT]")]
    pub address: Vec<String>,
    /// Sends nothing: finds only lidars that speak by themselves
    #[arg(long)]
    pub listen: bool,
    /// Prints JSON
    #[arg(long)]
    pub json: bool,
}

/// Which lidar is meant: one on a line of its own, or those of a running set.
#[derive(Clone, Debug, Args)]
pub struct LidarAtArgs {
    /// Family of the lidar: ld06, rplidar, ydlidar, urg, sick-tim; found out when it is not given
    #[arg(long, value_name = "KIND", value_parser = family)]
    pub kind: Option<Family>,
    /// Its serial port
    #[arg(long, value_name = "PORT", conflicts_with = "address")]
    pub port: Option<PathBuf>,
    /// Its host, with its TCP port where that is another than usual
    #[arg(long, value_name = "HOST[:PORT]")]
    pub address: Option<String>,
    /// The rate of its serial line, bits a second
    #[arg(long, value_name = "BAUD")]
    pub baud: Option<u32>,
    /// Its model
    #[arg(long, value_name = "MODEL")]
    pub model: Option<String>,
    /// The running set, where no port and no address is given
    #[command(flatten)]
    pub robot: RobotArgs,
}

impl LidarAtArgs {
    /// The line that is meant; `None` for a running set.
    pub fn line(&self) -> Option<LidarLine> {
        let is_line = self.port.is_some() || self.address.is_some();
        is_line.then(|| LidarLine {
            port: self.port.clone(),
            address: self.address.clone(),
            baud: self.baud,
            model: self.model.clone(),
        })
    }
}

/// `flockslam lidar watch`.
#[derive(Clone, Debug, Args)]
pub struct LidarWatchArgs {
    /// Which lidar
    #[command(flatten)]
    pub at: LidarAtArgs,
    /// Prints a line for each turn instead of drawing
    #[arg(long)]
    pub plain: bool,
    /// Ends after so many turns
    #[arg(long, value_name = "N")]
    pub turns: Option<u64>,
}

/// `flockslam lidar learn-mask`.
#[derive(Clone, Debug, Args)]
pub struct LearnMaskArgs {
    /// Which lidar
    #[command(flatten)]
    pub at: LidarAtArgs,
    /// Learns for so long, or until Ctrl-C
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    pub seconds: u64,
}

pub(crate) fn family(text: &str) -> Result<Family, String> {
    let known = || Family::ALL.map(Family::name).join(", ");
    let found = Family::ALL.into_iter().find(|family| family.name() == text);
    found.ok_or_else(|| format!("known are {}", known()))
}
