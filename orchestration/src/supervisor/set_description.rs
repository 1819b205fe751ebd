//! The file that `flockslam up` is given. Takes TOML; gives the configuration of the stages, their limits, and the source.

use super::lidar_description::{LidarLine, NamedLidar};
use super::{ProcessLimits, Supervision};
use crate::configuration::{Configuration, ConfigurationError, Profile, parse_file};
use flockslam_lidar_ingest::process::{LidarSpec, Source};
use flockslam_lidars::Family;
use flockslam_messages::Stage;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Most processes of one stage.
const REPLICAS_MAX: usize = 8;
/// Lidars of one robot.
const LIDARS_MAX: usize = 16;
/// No period is longer than a year, seconds.
const PERIOD_MAX_S: f64 = 366.0 * 86_400.0;

/// A process set as a file describes it: what `flockslam up SET.toml` runs. Paths are relative to the file.
///
/// ```
/// use flockslam::supervisor::{SetDescription, SourceDescription};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("set.toml");
/// std::fs::write(&path, "robot = \"r1\"\n[source]\nkind = \"log\"\npath = \"drive.log\"\n")?;
/// let description = SetDescription::read(&path)?;
/// assert_eq!(description.robot, "r1");
/// assert!(matches!(description.source, SourceDescription::Log { rate, .. } if rate == 1.0));
///
/// // A key that is not known is refused.
/// std::fs::write(&path, "robot = \"r1\"\nretri_s = 5.0\n")?;
/// let refused = SetDescription::read(&path).unwrap_err().to_string();
/// assert!(refused.contains("did you mean `retry_s`?"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetDescription {
    /// Name of the set on this machine: letters, digits and `-`, at most 22.
    pub robot: String,
    /// Where the map is kept on disk: continued from there, and saved there.
    pub map: Option<PathBuf>,
    /// A map to localize in, instead of making one: a saved map, the outputs of a run, a nav2 map.yaml, or `ros` for that which another
    /// node of the graph publishes.
    pub localize: Option<PathBuf>,
    /// The map is saved so often, seconds.
    #[serde(default = "save_every_s")]
    pub save_every_s: f64,
    /// A stage that does not get up is tried again after so long, seconds.
    #[serde(default = "retry_s")]
    pub retry_s: f64,
    /// Port on 127.0.0.1 that serves the metrics of all stages.
    pub metrics_port: Option<u16>,
    /// File with the configuration of the stages.
    pub config: Option<PathBuf>,
    /// Single settings over it, as for `--set`.
    #[serde(default)]
    pub set: Vec<String>,
    /// Where scans come from.
    #[serde(default)]
    pub source: SourceDescription,
    /// What each stage may use.
    #[serde(default)]
    pub stages: StageLimits,
    /// The bridge to a ROS 2 graph; none without it.
    pub ros: Option<RosDescription>,
}

/// The bridge of a set to a ROS 2 graph.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RosDescription {
    /// What stands behind `--ros-args` on a node's command line.
    pub args: Vec<String>,
}

/// Where the scans of a set come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum SourceDescription {
    /// CARMEN lines or frames on the standard input: a driver's output.
    Stdin {},
    /// Frames on a local socket.
    Scans {
        /// The socket; in the directory of the set when it is not named.
        path: Option<PathBuf>,
    },
    /// An LDROBOT LD06, LD19, STL-19P or LDS-02.
    Ld06(LidarLine),
    /// A Slamtec RPLIDAR.
    Rplidar(LidarLine),
    /// A YDLIDAR.
    Ydlidar(LidarLine),
    /// A Hokuyo URG or UST.
    Urg(LidarLine),
    /// A SICK TiM or LMS1xx.
    SickTim(LidarLine),
    /// Several lidars.
    Lidars {
        /// Each with a name of its own.
        lidars: Vec<NamedLidar>,
    },
    /// A CARMEN log.
    Log {
        /// The log.
        path: PathBuf,
        /// Log seconds per second.
        #[serde(default = "rate")]
        rate: f64,
    },
    /// The simulated world.
    Simulation {
        /// A map (nav2 YAML) to simulate in, in place of a built-in world.
        world: Option<PathBuf>,
        /// Simulated seconds per second.
        #[serde(default = "rate")]
        rate: f64,
    },
}

impl SourceDescription {
    /// Lidars on lines of their own; none of another source.
    ///
    /// # Errors
    /// The key that is wrong, and why.
    fn lidars(&self) -> Result<Vec<LidarSpec>, (String, String)> {
        let one = |line: &LidarLine, family| {
            let spec = line.spec("", family).map_err(|(key, reason)| (format!("source.{key}"), reason))?;
            Ok(vec![spec])
        };
        match self {
            Self::Ld06(line) => one(line, Family::Ld06),
            Self::Rplidar(line) => one(line, Family::Rplidar),
            Self::Ydlidar(line) => one(line, Family::Ydlidar),
            Self::Urg(line) => one(line, Family::Urg),
            Self::SickTim(line) => one(line, Family::SickTim),
            Self::Lidars { lidars } => named(lidars),
            Self::Stdin {} | Self::Scans { .. } | Self::Log { .. } | Self::Simulation { .. } => {
                Ok(Vec::new())
            }
        }
    }
}

/// Several lidars; each must have a name of its own.
fn named(lidars: &[NamedLidar]) -> Result<Vec<LidarSpec>, (String, String)> {
    let key = |at: usize, key: &str| format!("source.lidars[{at}].{key}");
    if lidars.is_empty() || lidars.len() > LIDARS_MAX {
        let reason = format!("{} lidars: between 1 and {LIDARS_MAX} are possible", lidars.len());
        return Err(("source.lidars".to_owned(), reason));
    }
    for (at, lidar) in lidars.iter().enumerate() {
        if lidar.name.is_empty() || lidars[..at].iter().any(|other| other.name == lidar.name) {
            return Err((key(at, "name"), format!("{:?} is not a name of its own", lidar.name)));
        }
    }
    let spec =
        |(at, lidar): (usize, &NamedLidar)| lidar.spec().map_err(|(wrong, reason)| (key(at, wrong), reason));
    lidars.iter().enumerate().map(spec).collect()
}

impl Default for SourceDescription {
    fn default() -> Self {
        Self::Stdin {}
    }
}

/// What the processes of each stage may use.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", default, deny_unknown_fields)]
pub struct StageLimits {
    /// Of lidar-ingest.
    pub lidar_ingest: ProcessLimits,
    /// Of correlation-filter.
    pub correlation_filter: ProcessLimits,
    /// Of scan-matcher.
    pub scan_matcher: ProcessLimits,
    /// Of mapper.
    pub mapper: ProcessLimits,
    /// Of dynamic-cleaner.
    pub dynamic_cleaner: ProcessLimits,
    /// Of sync-manager.
    pub sync_manager: ProcessLimits,
}

/// What a source is to the stage that reads it.
pub struct SourceTask {
    /// Where scans come from.
    pub source: Source,
    /// Log seconds per second; `None` for what has a pace of its own.
    pub rate: Option<f64>,
    /// A map to simulate in.
    pub world: Option<PathBuf>,
}

fn save_every_s() -> f64 {
    5.0
}

fn retry_s() -> f64 {
    60.0
}

fn rate() -> f64 {
    1.0
}

/// Whether a set localizes in the map that another node of the ROS graph publishes: `localize = "ros"`.
pub fn is_of_graph(localize: &Path) -> bool {
    localize == Path::new("ros")
}

impl SetDescription {
    /// Reads a description.
    ///
    /// # Errors
    /// When it cannot be read, or has a key or value that is not known: with line, reason and a hint.
    pub fn read(path: &Path) -> Result<Self, ConfigurationError> {
        let mut description: Self = parse_file(path)?;
        description.check(path)?;
        let base = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let base = base.parent().unwrap_or(Path::new("/")).to_owned();
        let beside = |path: &mut PathBuf| *path = base.join(&*path);
        description.map.iter_mut().for_each(beside);
        description.localize.iter_mut().filter(|map| !is_of_graph(map)).for_each(beside);
        description.config.iter_mut().for_each(beside);
        match &mut description.source {
            SourceDescription::Log { path, .. } => beside(path),
            SourceDescription::Simulation { world, .. } => world.iter_mut().for_each(beside),
            SourceDescription::Scans { path } => path.iter_mut().for_each(beside),
            _ => {}
        }
        Ok(description)
    }

    fn check(&self, path: &Path) -> Result<(), ConfigurationError> {
        let refused = |key: &str, reason: String| {
            Err(ConfigurationError::Value { key: format!("{}: {key}", path.display()), reason })
        };
        let positive = |key: &str, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(()),
            false => refused(key, format!("{value} is not a positive number")),
        };
        for (key, value_s) in [("save_every_s", self.save_every_s), ("retry_s", self.retry_s)] {
            positive(key, value_s)?;
            if value_s > PERIOD_MAX_S {
                return refused(key, format!("{value_s} is more than a year"));
            }
        }
        for (stage, limits) in self.supervision().limits {
            if let Some(replicas) = limits.replicas.filter(|replicas| !(1..=REPLICAS_MAX).contains(replicas))
            {
                let reason = format!("{replicas} is not between 1 and {REPLICAS_MAX}");
                return refused(&format!("stages.{}.replicas", stage.name()), reason);
            }
        }
        match self.source {
            SourceDescription::Log { rate, .. } | SourceDescription::Simulation { rate, .. } => {
                positive("source.rate", rate)
            }
            _ => match self.source.lidars() {
                Ok(_) => Ok(()),
                Err((key, reason)) => refused(&key, reason),
            },
        }
    }

    /// The configuration of its stages, with more settings over it.
    ///
    /// # Errors
    /// When its file or a setting is not usable.
    pub fn configuration(&self, more: &[String]) -> Result<Configuration, ConfigurationError> {
        let assignments = [self.set.as_slice(), more].concat();
        let mut configuration = Configuration::load(Profile::Default, self.config.as_deref(), &assignments)?;
        for (stage, limits) in self.supervision().limits {
            limits.replicas.into_iter().for_each(|replicas| configuration.set_replicas(stage, replicas));
        }
        Ok(configuration)
    }

    /// How the set is watched over.
    pub fn supervision(&self) -> Supervision {
        let stages = &self.stages;
        let limits = BTreeMap::from([
            (Stage::LidarIngest, stages.lidar_ingest.clone()),
            (Stage::CorrelationFilter, stages.correlation_filter.clone()),
            (Stage::ScanMatcher, stages.scan_matcher.clone()),
            (Stage::Mapper, stages.mapper.clone()),
            (Stage::DynamicCleaner, stages.dynamic_cleaner.clone()),
            (Stage::SyncManager, stages.sync_manager.clone()),
        ]);
        Supervision { live: true, retries_max: None, limits, retry: Duration::from_secs_f64(self.retry_s) }
    }

    /// What its source is to lidar-ingest.
    pub fn source(&self) -> SourceTask {
        match self.source.clone() {
            SourceDescription::Stdin {} => SourceTask { source: Source::Pipe, rate: None, world: None },
            SourceDescription::Scans { path } => {
                SourceTask { source: Source::Scans(path), rate: None, world: None }
            }
            SourceDescription::Log { path, rate } => {
                SourceTask { source: Source::Log(path), rate: Some(rate), world: None }
            }
            SourceDescription::Simulation { world, rate } => {
                SourceTask { source: Source::Simulation, rate: Some(rate), world }
            }
            // What cannot be meant was refused when the description was read.
            lidars => {
                let lidars = lidars.lidars().unwrap_or_default();
                SourceTask { source: Source::Lidars(lidars), rate: None, world: None }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<SetDescription, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("set.toml");
        std::fs::write(&path, text).unwrap();
        let name = path.display().to_string();
        SetDescription::read(&path).map_err(|error| error.to_string().replace(&name, "set.toml"))
    }

    #[test]
    fn a_name_is_enough() {
        let description = read("robot = \"r1\"").unwrap();
        assert_eq!((description.source, description.save_every_s), (SourceDescription::Stdin {}, 5.0));
        assert_eq!(description.stages.mapper.deadline(Stage::Mapper), Duration::from_millis(500));
    }

    #[test]
    fn every_key_of_a_set_can_be_said_and_paths_are_beside_the_file() {
        let directory = tempfile::tempdir().unwrap();
        let beside = |name: &str| std::path::absolute(directory.path()).unwrap().join(name);
        std::fs::write(beside("robot.toml"), "[page]\nenabled = false\n").unwrap();
        let read = |text: &str| {
            std::fs::write(beside("set.toml"), text).unwrap();
            SetDescription::read(&beside("set.toml")).unwrap()
        };
        let description = read(
            "robot = \"r1\"\nmap = \"maps/r1\"\nsave_every_s = 2.5\nretry_s = 7.0\nmetrics_port = 9100\n\
             config = \"robot.toml\"\nset = [\"mapper.cell_size_m=0.1\"]\n\
             [source]\nkind = \"log\"\npath = \"drive.log\"\nrate = 2.0\n\
             [stages.mapper]\nreplicas = 2\ncpus = [0]\nmemory_max_bytes = 100000000\nnice = 5\n\
             deadline_ms = 2000\n",
        );
        assert_eq!(description.map, Some(beside("maps/r1")));
        assert_eq!((description.save_every_s, description.metrics_port), (2.5, Some(9100)));
        let configuration = description.configuration(&[]).unwrap();
        assert_eq!((configuration.mapper.cell_size_m, configuration.mapper.replicas), (0.1, 2));
        assert!(!configuration.page.enabled, "its file counts");
        let over = description.configuration(&["mapper.cell_size_m=0.2".to_owned()]).unwrap();
        assert_eq!(over.mapper.cell_size_m, 0.2);
        let supervision = description.supervision();
        assert_eq!((supervision.live, supervision.retry), (true, Duration::from_secs(7)));
        let mapper = supervision.limits(Stage::Mapper);
        assert_eq!((mapper.nice, mapper.cpus.as_slice()), (Some(5), [0].as_slice()));
        assert_eq!(mapper.memory_max_bytes, Some(100_000_000));
        assert_eq!(mapper.deadline(Stage::Mapper), Duration::from_secs(2));
        let task = description.source();
        assert!(matches!(task.source, Source::Log(path) if path == beside("drive.log")));
        assert_eq!(task.rate, Some(2.0));
        let task = read("robot = \"r1\"\n[source]\nkind = \"scans\"\n").source();
        assert_eq!((task.source, task.rate), (Source::Scans(None), None));
        let task = read("robot = \"r1\"\n[source]\nkind = \"scans\"\npath = \"lidars\"\n").source();
        assert_eq!(task.source, Source::Scans(Some(beside("lidars"))));
        let lidar = "robot = \"r1\"\n[source]\nkind = \"ydlidar\"\nport = \"/dev/ttyUSB0\"\nbaud = 230400\n\
            model = \"T-mini Plus\"\n";
        let Source::Lidars(lidars) = read(lidar).source().source else { panic!("{lidar}") };
        let found = (lidars[0].to_string(), lidars[0].rate);
        assert_eq!(found, ("lidar (ydlidar at /dev/ttyUSB0)".to_owned(), Some(230_400)));
        let two = "robot = \"r1\"\n[source]\nkind = \"lidars\"\n\
            lidars = [{ name = \"front\", kind = \"ld06\", port = \"/dev/ttyUSB0\" },\n\
            { name = \"rear\", kind = \"sick-tim\", address = \"192.168.0.1\" }]\n";
        let Source::Lidars(lidars) = read(two).source().source else { panic!("{two}") };
        assert_eq!(lidars[1].to_string(), "lidar 'rear' (sick-tim at 192.168.0.1)");
        let task =
            read("robot = \"r1\"\n[source]\nkind = \"simulation\"\nworld = \"maps/hall.yaml\"\n").source();
        assert!(matches!(task.source, Source::Simulation));
        assert_eq!((task.world, task.rate), (Some(beside("maps/hall.yaml")), Some(1.0)));
    }

    #[test]
    fn unknown_keys_are_refused_with_line_and_hint_and_bad_values_with_their_key() {
        let wrong = read("robot = \"r1\"\n[stages.maper]\nnice = 1\n").unwrap_err();
        assert!(wrong.starts_with("set.toml:2: ") && wrong.contains("did you mean `mapper`?"), "{wrong}");
        let wrong = read("robot = \"r1\"\n\n[stages.mapper]\nnise = 1\n").unwrap_err();
        assert!(wrong.starts_with("set.toml:4: ") && wrong.contains("did you mean `nice`?"), "{wrong}");
        let wrong = read("robto = \"r1\"").unwrap_err();
        assert!(wrong.starts_with("set.toml:1: ") && wrong.contains("did you mean `robot`?"), "{wrong}");
        assert!(read("robot = \"r1\"\n[source]\nkind = \"ros\"\n").unwrap_err().contains("unknown variant"));
        assert!(read("robot = \"r1\"\nsave_every_s = 0.0\n").unwrap_err().contains("save_every_s"));
        for period in ["-1.0", "0.0", "nan", "inf", "1e30"] {
            for key in ["retry_s", "save_every_s"] {
                let wrong = read(&format!("robot = \"r1\"\n{key} = {period}\n")).unwrap_err();
                assert!(wrong.contains(&format!("{key}: ")), "{wrong}");
            }
        }
        assert!(read("save_every_s = 1.0").unwrap_err().contains("robot"));
        let stdin = "robot = \"r1\"\n[source]\nkind = \"stdin\"\npath = \"x\"\n";
        assert!(read(stdin).is_err(), "a pipe has no path");
        for (source, key) in [
            ("kind = \"ld06\"", "source.port: where is the lidar?"),
            (
                "kind = \"rplidar\"\nport = \"p\"\nmodel = \"B7\"",
                "source.model: \"B7\" is no model of rplidar",
            ),
            ("kind = \"ld06\"\nport = \"p\"\nbuad = 9600", "unknown field `buad`"),
            ("kind = \"lidars\"\nlidars = []", "source.lidars: 0 lidars"),
            (
                "kind = \"lidars\"\nlidars = [{ name = \"a\", kind = \"ld06\", port = \"p\" }, \
                 { name = \"a\", kind = \"urg\", port = \"q\" }]",
                "source.lidars[1].name: \"a\" is not a name of its own",
            ),
        ] {
            let wrong = read(&format!("robot = \"r1\"\n[source]\n{source}\n")).unwrap_err();
            assert!(wrong.contains(key), "{wrong}");
        }
        let none = "robot = \"r1\"\n[stages.mapper]\nreplicas = 0\n";
        assert!(read(none).unwrap_err().contains("stages.mapper.replicas: 0 is not between 1 and 8"));
    }
}
