//! The arguments of all commands.

use crate::configuration::Profile;
use crate::doctor_arguments::DoctorArgs;
use crate::lidar_arguments::LidarCommand;
use crate::localisation_arguments::{ModeArgs, RelocalizeArgs};
use crate::manuals_arguments::ManualsArgs;
use crate::setup_arguments::SetupArgs;
pub use crate::stage_arguments::StageArgs;
use crate::supervisor::known_stage;
use crate::topic_arguments::TopicArgs;
use clap::{Args, Parser, Subcommand, ValueEnum};
use flockslam_messages::Stage;
use flockslam_published_methods::CellFusion;
use serde::Serialize;
use std::net::SocketAddr;
use std::path::PathBuf;

/// 2-D lidar SLAM for a flock of small robots.
#[derive(Debug, Parser)]
#[command(name = "flockslam", version, about)]
pub struct Cli {
    /// What is to be done
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Turns a lidar log into a map, a trajectory, a picture and a report, by six processes
    Map(MapArgs),
    /// Says what is in a recording, what would be read of it, and what it lacks
    Inspect(InspectArgs),
    /// The same from a simulated building, with its error against the exact truth
    Demo(DemoArgs),
    /// Lets several robots, each a process set of its own, map together: spans of one log, or the simulated building
    Swarm(SwarmArgs),
    /// Runs a process set until it is stopped
    Up(UpArgs),
    /// Saves and stops a running set
    Down(RobotArgs),
    /// Prints how a running set is
    Status(StatusArgs),
    /// Replaces the processes of a stage of a running set
    Restart(StageOrderArgs),
    /// Lets a running set rest: no scan is handled until `resume`
    Pause(RobotArgs),
    /// Lets a set that rests go on
    Resume(RobotArgs),
    /// Lets a running set drop its map and begin a new one
    Reset(RobotArgs),
    /// Lets a set that localizes look for its robot in the known map anew
    Relocalize(RelocalizeArgs),
    /// Lets a running set localize in its map as it is, or map again
    Mode(ModeArgs),
    /// Changes how many processes a stage of a running set has
    Scale(ScaleArgs),
    /// Shows a running set live in the terminal: stages, latencies, drops, restarts
    Top(RobotArgs),
    /// Prints what a running set has logged, or changes what it logs
    Log(LogArgs),
    /// Serves the live page of a running set, for a browser
    Page(PageArgs),
    /// Makes a running set a node of a ROS 2 graph
    Ros(RosArgs),
    /// Records what a running set says, for Foxglove and the public MCAP tools
    Record(RecordArgs),
    /// Lidars on lines of their own: which are there, what they see
    #[command(subcommand)]
    Lidar(LidarCommand),
    /// Finds the lidar, shows its scan, asks for the rest, writes the description of a set and starts it
    Setup(SetupArgs),
    /// Says what is wrong with this machine and with a set, each with its cure
    Doctor(DoctorArgs),
    /// Looks after saved maps
    #[command(subcommand)]
    Store(StoreCommand),
    /// Measures a trajectory against ground truth
    Evaluate(EvaluateArgs),
    /// Prints the configuration in force as TOML
    Config(ConfigurationArgs),
    /// Writes man pages and completions of shells (what packages are made with)
    #[command(hide = true)]
    Manuals(ManualsArgs),
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
    /// CARMEN log, ROS 1 bag, rosbag2 folder, .db3 or .mcap file
    #[arg(value_name = "RECORDING", required_unless_present = "source", conflicts_with = "source")]
    pub log: Option<PathBuf>,
    /// Where scans come from, in place of a log: `-` reads CARMEN lines or frames from the standard input as they arrive, `scans` frames
    /// from a local socket in the directory of the set, `scans:PATH` from one at this path
    #[arg(long, value_name = "-|scans|scans:PATH")]
    pub source: Option<PathBuf>,
    /// Of a recording by `flockslam record`: computes the poses that were published live, with what each stage had in hand then, and
    /// compares them
    #[arg(
        long,
        requires = "log",
        conflicts_with_all = ["source", "scan", "odom", "imu", "rate", "live", "robot", "metrics_port", "config", "assignments", "profile"]
    )]
    pub as_it_was: bool,
    /// What is read of the recording
    #[command(flatten)]
    pub topics: TopicArgs,
    /// What every run shares
    #[command(flatten)]
    pub run: RunArgs,
}

/// `flockslam inspect`.
#[derive(Clone, Debug, Args)]
pub struct InspectArgs {
    /// CARMEN log, ROS 1 bag, rosbag2 folder, .db3 or .mcap file
    #[arg(value_name = "RECORDING")]
    pub recording: PathBuf,
    /// What would be read of it
    #[command(flatten)]
    pub topics: TopicArgs,
    /// Finds what the lidars see of the robot itself, and prints the setting that masks it; the robot has to drive
    #[arg(long)]
    pub learn_mask: bool,
    /// Prints JSON
    #[arg(long)]
    pub json: bool,
    /// Settings
    #[command(flatten)]
    pub configuration: ConfigurationArgs,
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
    /// Find the robot in this map and follow it there, instead of making a map: a saved map, the outputs of a run, or a nav2 map.yaml.
    /// The map is only read
    #[arg(long, value_name = "MAP")]
    pub localize: Option<PathBuf>,
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

/// `flockslam swarm`.
#[derive(Clone, Debug, Args)]
pub struct SwarmArgs {
    /// CARMEN log, of which each robot gets an equal span of time; without it the robots drive through the simulated building, each
    /// with a seed of its own
    #[arg(value_name = "LOG")]
    pub log: Option<PathBuf>,
    /// Live, at this many log seconds per second: the robots run at once and meet over the network, on this machine; without it
    /// each is replayed exactly, and they meet at the end
    #[arg(long, value_name = "RATE", value_parser = positive)]
    pub rate: Option<f64>,
    /// In the simulated building, live: only robots that are nearer than this, metres, and see each other talk until
    /// their drives have ended; without it all do
    #[arg(long, value_name = "METRES", value_parser = positive, requires = "rate", conflicts_with = "log")]
    pub range: Option<f64>,
    /// Number of robots
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub robots: u32,
    /// Seed of the motions by which each robot's odometry is moved away, so that nothing of how they lie to each other leaks
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    pub seed: u64,
    /// How robots come to one map
    #[arg(long, value_enum, default_value_t)]
    pub protocol: ProtocolArg,
    /// How cells of several maps become one, in the protocol of meetings
    #[arg(long, value_enum, default_value_t)]
    pub fusion: FusionArg,
    /// Directory for the outputs; made when it is not there
    #[arg(long, value_name = "DIR", default_value = "flockslam-out")]
    pub out: PathBuf,
    /// How each robot is configured
    #[command(flatten)]
    pub configuration: ConfigurationArgs,
}

/// How robots come to one map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ProtocolArg {
    /// All exchange what they have recorded, and each works out the same map
    #[default]
    Records,
    /// When two meet, each looks for the other's current scan in its map and takes over the other's map
    Meeting,
}

/// How cells of several maps become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FusionArg {
    /// Dempster's rule
    #[default]
    Dempster,
    /// The greatest occupancy
    Maximum,
    /// The least occupancy
    Minimum,
    /// The mean occupancy
    Mean,
}

impl From<FusionArg> for CellFusion {
    fn from(argument: FusionArg) -> Self {
        match argument {
            FusionArg::Dempster => Self::Dempster,
            FusionArg::Maximum => Self::Maximum,
            FusionArg::Minimum => Self::Minimum,
            FusionArg::Mean => Self::Mean,
        }
    }
}

/// `flockslam up`.
#[derive(Clone, Debug, Args)]
pub struct UpArgs {
    /// Description of the process set (TOML)
    #[arg(value_name = "SET.toml")]
    pub set: PathBuf,
    /// Continue the map in this directory, when there is one, and save it there while the set runs
    #[arg(long, value_name = "DIR")]
    pub map: Option<PathBuf>,
    /// Find the robot in this map and follow it there, instead of making a map: a saved map, the outputs of a run, or a nav2 map.yaml.
    /// The map is only read. `ros`: the map that another node of the graph publishes
    #[arg(long, value_name = "MAP", conflicts_with = "map")]
    pub localize: Option<PathBuf>,
    /// When the source ends, write the outputs of `map` into this directory
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// One setting, for example --set mapper.cell_size_m=0.1; may be given many times
    #[arg(long = "set", value_name = "SECTION.KEY=VALUE")]
    pub assignments: Vec<String>,
    /// Makes the set a node of a ROS 2 graph, with these arguments of a node: -r FROM:=TO, -p NAME:=VALUE, --params-file FILE
    #[arg(long, value_name = "ARGUMENT", num_args = 0.., allow_hyphen_values = true)]
    pub ros_args: Vec<String>,
}

/// `flockslam store`.
#[derive(Clone, Debug, Subcommand)]
pub enum StoreCommand {
    /// Looks at every byte of a saved map; exit code 1 when something is damaged
    Check(MapDirArgs),
    /// Saves the map of a running set
    Save(MapOrderArgs),
    /// Lets a running set go on with a saved map instead of its own
    Load(MapOrderArgs),
    /// Makes the files of `flockslam map` from a saved map
    Export(ExportArgs),
    /// Makes a saved map of a map of somebody else, which a set localizes in, and goes on with
    Import(ImportArgs),
    /// Brings maps of different robots or sessions together, whose places to each other are not known
    Merge(MergeArgs),
}

/// `flockslam store check`.
#[derive(Clone, Debug, Args)]
pub struct MapDirArgs {
    /// Directory of the map
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
}

/// `flockslam store save` and `load`.
#[derive(Clone, Debug, Args)]
pub struct MapOrderArgs {
    /// Directory of the map
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// `flockslam store export`.
#[derive(Clone, Debug, Args)]
pub struct ExportArgs {
    /// Directory of the map
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Directory for the outputs; made when it is not there
    #[arg(long, value_name = "DIR", default_value = "flockslam-out")]
    pub out: PathBuf,
    /// How the map was made
    #[command(flatten)]
    pub configuration: ConfigurationArgs,
}

/// `flockslam store import`.
#[derive(Clone, Debug, Args)]
pub struct ImportArgs {
    /// Map of nav2's map server: YAML beside PNG or PGM
    #[arg(value_name = "MAP.yaml")]
    pub map: PathBuf,
    /// Directory for the saved map, which must not hold one
    #[arg(long, value_name = "DIR", default_value = "flockslam-map")]
    pub out: PathBuf,
    /// How sets are configured that shall use the map
    #[command(flatten)]
    pub configuration: ConfigurationArgs,
}

/// `flockslam store merge`.
#[derive(Clone, Debug, Args)]
pub struct MergeArgs {
    /// Directories of the maps; the first gives the frame
    #[arg(value_name = "DIR", num_args = 2.., required = true)]
    pub directories: Vec<PathBuf>,
    /// Directory for the outputs; made when it is not there
    #[arg(long, value_name = "DIR", default_value = "flockslam-out")]
    pub out: PathBuf,
    /// How the maps were made
    #[command(flatten)]
    pub configuration: ConfigurationArgs,
}

/// Which running set is meant.
#[derive(Clone, Debug, Args)]
pub struct RobotArgs {
    /// Name of the set; not needed while only one is running
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
}

/// `flockslam status`.
#[derive(Clone, Debug, Args)]
pub struct StatusArgs {
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
    /// As JSON, for programs
    #[arg(long)]
    pub json: bool,
}

/// `flockslam restart`.
#[derive(Clone, Debug, Args)]
pub struct StageOrderArgs {
    /// Which stage
    #[arg(value_parser = known_stage)]
    pub stage: Stage,
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// `flockslam scale`.
#[derive(Clone, Debug, Args)]
pub struct ScaleArgs {
    /// How many processes of which stage
    #[arg(value_name = "STAGE=N", value_parser = stage_and_number)]
    pub wanted: (Stage, usize),
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// `flockslam log`.
#[derive(Clone, Debug, Args)]
pub struct LogArgs {
    /// What a stage (or supervisor, or all) logs from now on, for example scan-matcher=debug; nothing behind the = brings back what
    /// it began with. Without any, prints what was logged so far
    #[arg(value_name = "STAGE=FILTER", value_parser = name_and_filter)]
    pub levels: Vec<(String, String)>,
    /// Print it as it is stored: a JSON object a line
    #[arg(long)]
    pub json: bool,
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
}

/// `flockslam page`.
#[derive(Clone, Debug, Args)]
pub struct PageArgs {
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
    /// Address and port at which it is served, in place of the set's `page.listen`
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<SocketAddr>,
    /// Directory of the running set
    #[arg(long, value_name = "DIR", hide = true)]
    pub set_dir: Option<PathBuf>,
    /// Process to die with
    #[arg(long, hide = true)]
    pub parent: Option<u32>,
}

/// `flockslam ros`.
#[derive(Clone, Debug, Args)]
pub struct RosArgs {
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
    /// Directory of the running set
    #[arg(long, value_name = "DIR", hide = true)]
    pub set_dir: Option<PathBuf>,
    /// Process to die with
    #[arg(long, hide = true)]
    pub parent: Option<u32>,
    /// Arguments of a node: -r FROM:=TO, -p NAME:=VALUE, --params-file FILE
    #[arg(long, value_name = "ARGUMENT", num_args = 0.., allow_hyphen_values = true)]
    pub ros_args: Vec<String>,
}

/// `flockslam record`.
#[derive(Clone, Debug, Args)]
pub struct RecordArgs {
    /// File to record into; it must not be there yet
    #[arg(value_name = "OUT.mcap", required_unless_present = "foxglove")]
    pub out: Option<PathBuf>,
    /// Serve it live to Foxglove on a websocket on 127.0.0.1 at this port; 0 takes a free one
    #[arg(long, value_name = "PORT")]
    pub foxglove: Option<u16>,
    /// Which set
    #[command(flatten)]
    pub robot: RobotArgs,
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

fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("it must be positive".to_owned()) }
}

fn stage_and_number(text: &str) -> Result<(Stage, usize), String> {
    let (stage, number) = text.split_once('=').ok_or("write it as STAGE=N")?;
    let number = number.parse().map_err(|_| format!("'{number}' is not a number"))?;
    Ok((known_stage(stage)?, number))
}

fn name_and_filter(text: &str) -> Result<(String, String), String> {
    let (name, filter) =
        text.split_once('=').ok_or("write it as STAGE=FILTER, for example scan-matcher=debug")?;
    Ok((name.to_owned(), filter.to_owned()))
}
