//! The command line.

use crate::commands::{self, CommandError};
use crate::configuration::Profile;
use clap::{Args, Parser, Subcommand};
use flockslam_messages::Stage;
use std::path::PathBuf;
use std::process::ExitCode;

/// 2-D lidar SLAM for a flock of small robots.
#[derive(Debug, Parser)]
#[command(name = "flockslam", version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Turns a lidar log into a map, a trajectory, a picture and a report, by six processes
    Map(MapArgs),
    /// The same from a simulated building, with its error against the exact truth
    Demo(DemoArgs),
    /// Measures a trajectory against ground truth
    Evaluate(EvaluateArgs),
    /// Prints the configuration in force as TOML
    Config(ConfigurationArgs),
    /// Runs one stage of a set (what the supervisor starts)
    #[command(hide = true)]
    Stage(StageArgs),
}

/// How a set is configured.
#[derive(Clone, Debug, Args)]
pub struct ConfigurationArgs {
    /// TOML file with settings; unknown keys are refused
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One setting, for example --set mapper.cell_size_m=0.1; may be given many times
    #[arg(long = "set", value_name = "SECTION.KEY=VALUE")]
    pub assignments: Vec<String>,
    /// A set of values under one name
    #[arg(long, value_enum, default_value = "default")]
    pub profile: Profile,
}

/// `flockslam map`.
#[derive(Clone, Debug, Args)]
pub struct MapArgs {
    /// CARMEN log
    #[arg(value_name = "LOG", required_unless_present = "source", conflicts_with = "source")]
    pub log: Option<PathBuf>,
    /// Where scans come from, in place of a log: `-` reads CARMEN lines from the standard input as they arrive
    #[arg(long, value_name = "-")]
    pub source: Option<PathBuf>,
    /// Afterwards match all scans once more, to the map that they make together, and make the map anew from them: adds
    /// trajectory_refined.tum and submaps/
    #[arg(long)]
    pub refine: bool,
    /// What every run shares
    #[command(flatten)]
    pub run: RunArgs,
}

/// What every run of a set needs.
#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    /// Directory for the outputs; made when it is not there
    #[arg(long, value_name = "DIR", default_value = "flockslam-out")]
    pub out: PathBuf,
    /// Live replay at this many log seconds per second; without it an exact replay at full speed
    #[arg(long, value_name = "RATE", value_parser = positive)]
    pub rate: Option<f64>,
    /// Live operation: nothing is waited for past its deadline; a recorded source is replayed at --rate 1
    #[arg(long)]
    pub live: bool,
    /// Name of the robot's process set
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
    /// Serve the metrics of all stages on 127.0.0.1 at this port
    #[arg(long, value_name = "PORT")]
    pub metrics_port: Option<u16>,
    /// How the set is configured
    #[command(flatten)]
    pub configuration: ConfigurationArgs,
}

/// `flockslam demo`.
#[derive(Clone, Debug, Args)]
pub struct DemoArgs {
    /// Simulate in this map (nav2 YAML beside its picture) instead of the built-in building
    #[arg(long, value_name = "YAML")]
    pub world: Option<PathBuf>,
    /// What every run shares
    #[command(flatten)]
    pub run: RunArgs,
}

/// `flockslam evaluate`.
#[derive(Clone, Debug, Args)]
pub struct EvaluateArgs {
    /// The trajectory to measure (TUM)
    #[arg(long, value_name = "TUM")]
    pub trajectory: PathBuf,
    /// Relations between poses (ground truth): `t1 t2 dx dy dz roll pitch yaw`
    #[arg(long, value_name = "FILE", required_unless_present = "truth")]
    pub relations: Option<PathBuf>,
    /// Exact trajectory (TUM): absolute and relative errors
    #[arg(long, value_name = "TUM")]
    pub truth: Option<PathBuf>,
    /// Write the figures to this file as well
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// `flockslam stage`.
#[derive(Clone, Debug, Args)]
pub struct StageArgs {
    /// Which stage
    #[arg(value_parser = stage)]
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
}

fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("it must be positive".to_owned()) }
}

fn stage(text: &str) -> Result<Stage, String> {
    let names = || Stage::ALL.map(Stage::name).join(", ");
    Stage::from_name(text).ok_or_else(|| format!("'{text}' is not a stage; there are {}", names()))
}

/// Parses the command line and runs it. What a user did wrong ends with exit code 2, what went wrong here with 1.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let outcome = match cli.command {
        Command::Stage(args) => return commands::stage::run(&args),
        Command::Map(args) => commands::map::run(&args),
        Command::Demo(args) => commands::demo::run(&args),
        Command::Evaluate(args) => commands::evaluate::run(&args),
        Command::Config(args) => commands::config::run(&args),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("flockslam: {error}");
            ExitCode::from(if matches!(error, CommandError::User(_)) { 2 } else { 1 })
        }
    }
}
