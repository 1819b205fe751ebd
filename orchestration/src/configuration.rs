//! The configuration of a process set: defaults, then a profile, then a TOML file, then single keys.

#[cfg(test)]
mod documented;
mod hint;
pub mod old_keys;
mod range;

use flockslam_messages::Stage;
use flockslam_stage::{Mode, StageOptions};
use hint::with_hint;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Scans that may be on their way at once: 6 s of a lidar of 10 Hz, which bridges the restart of a stage.
const WINDOW: usize = 64;

/// Everything that can be set. Each section belongs to the stage of its name.
///
/// ```
/// use flockslam::configuration::{Configuration, ConfigurationError, Profile};
///
/// let overrides = ["mapper.cell_size_m=0.1", "page.enabled=false"].map(str::to_owned);
/// let configuration = Configuration::load(Profile::Default, None, &overrides)?;
/// assert_eq!(configuration.mapper.cell_size_m, 0.1);
/// assert!(!configuration.page.enabled);
///
/// // A key that is not known is refused.
/// let refused = Configuration::load(Profile::Default, None, &["mapper.cel_size_m=0.1".to_owned()]);
/// assert!(refused.unwrap_err().to_string().contains("did you mean `cell_size_m`?"));
/// # Ok::<(), ConfigurationError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Configuration {
    /// Sizes of the process set.
    pub set: SetSettings,
    /// Reading a source, and experiments on it.
    pub lidar_ingest: flockslam_lidar_ingest::Settings,
    /// The simulated building.
    pub simulation: flockslam_simulation::Settings,
    /// Which scans are processed.
    pub correlation_filter: flockslam_correlation_filter::Settings,
    /// How a scan is fitted to the grid.
    pub scan_matcher: flockslam_scan_matcher::Settings,
    /// How evidence is gathered.
    pub mapper: flockslam_mapper::Settings,
    /// How stale cells are found.
    pub dynamic_cleaner: flockslam_dynamic_cleaner::Settings,
    /// How loops are closed.
    pub sync_manager: flockslam_sync_manager::Settings,
    /// The live page.
    pub page: flockslam_page::Settings,
}

/// Sizes of the process set, fixed when it starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SetSettings {
    /// Greatest number of live tiles (3.2 × 3.2 m each with cells of 5 cm).
    pub live_tiles: usize,
    /// Directory on disk for what grows with the way driven and is rarely read: closed submaps, the journal, trajectories. Each set has a
    /// folder of its own in it, as long as it runs. When it is not set: beside the map directory, else `$STATE_DIRECTORY`,
    /// `$XDG_STATE_HOME/flockslam` or `~/.local/state/flockslam`, else in the directory for temporary files: the first that can be
    /// written and has 16 MB of room; without any, in `/dev/shm`.
    pub spill_dir: Option<PathBuf>,
}

impl Default for SetSettings {
    fn default() -> Self {
        Self { live_tiles: 4096, spill_dir: None }
    }
}

/// A set of values under one name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Profile {
    /// What measures best.
    Default,
    /// The program vinySLAM: 0.1 m cells, its masses and blur, hill climbing, every scan inserted, no filter, no closures.
    Vinyslam,
    /// Point-to-distribution matching from the odometry guess, every scan inserted, stale points removed by ray tracing in
    /// sectors; no filter, no closures.
    Ndt,
}

/// Why a configuration is refused: one line with place and reason.
#[derive(Debug, thiserror::Error)]
pub enum ConfigurationError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Message of the system.
        source: std::io::Error,
    },
    /// The file is not TOML, or has a key or value that is not known.
    #[error("{path}:{line}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// A single key is not known, or its value does not fit.
    #[error("--set {assignment}: {reason}")]
    Assignment {
        /// As it was given.
        assignment: String,
        /// What is wrong.
        reason: String,
    },
    /// A value is known but makes no sense.
    #[error("{key}: {reason}")]
    Value {
        /// The key.
        key: String,
        /// What is wrong.
        reason: String,
    },
}

impl Configuration {
    /// The configuration of a profile.
    pub fn of_profile(profile: Profile) -> Self {
        let mut configuration = Self::default();
        match profile {
            Profile::Default => return configuration,
            Profile::Vinyslam => {
                configuration.scan_matcher = flockslam_scan_matcher::Settings::vinyslam();
                configuration.mapper = flockslam_mapper::Settings::vinyslam();
                configuration.dynamic_cleaner.enabled = false;
            }
            Profile::Ndt => {
                configuration.scan_matcher = flockslam_scan_matcher::Settings::ndt();
                configuration.mapper = flockslam_mapper::Settings::ndt();
                configuration.dynamic_cleaner = flockslam_dynamic_cleaner::Settings::sectors();
            }
        }
        configuration.correlation_filter.mode = flockslam_correlation_filter::Mode::Off;
        configuration.sync_manager.enabled = false;
        configuration.sync_manager.clear_at_end = false;
        configuration
    }

    /// Puts together a profile, a file and single keys (`section.key=value`).
    ///
    /// # Errors
    /// When the file cannot be read, or a key or value is not known: with place, reason and a hint.
    pub fn load(
        profile: Profile,
        file: Option<&Path>,
        assignments: &[String],
    ) -> Result<Self, ConfigurationError> {
        let mut table =
            Table::try_from(Self::of_profile(profile)).expect("a configuration can be written as TOML");
        if let Some(path) = file {
            merge(&mut table, read_file(path)?);
        }
        for assignment in assignments {
            let wrong =
                |reason: String| ConfigurationError::Assignment { assignment: assignment.clone(), reason };
            let assigned = parse_assignment(assignment).map_err(wrong)?;
            if let Some(text) = old_keys::in_table(&assigned) {
                return Err(wrong(text));
            }
            merge(&mut table, assigned);
            let known: Result<Self, _> = table.clone().try_into();
            known.map_err(|error| wrong(with_hint(error.message())))?;
        }
        let configuration: Self = table.try_into().expect("every part was checked");
        configuration.check()?;
        Ok(configuration)
    }

    /// What the stages need to know of it to start.
    pub fn stage_options(&self, mode: Mode) -> StageOptions {
        let most = Stage::ALL.into_iter().map(|stage| self.replicas(stage)).max();
        let replicas = most.unwrap_or(1).max(2);
        let (window, live_tiles) = (WINDOW, self.set.live_tiles);
        StageOptions { mode, window, replicas, live_tiles, first_sequence: 0, localizes: false }
    }

    /// Processes of a stage.
    pub fn replicas(&self, stage: Stage) -> usize {
        match stage {
            Stage::LidarIngest => self.lidar_ingest.replicas,
            Stage::CorrelationFilter => self.correlation_filter.replicas,
            Stage::ScanMatcher => self.scan_matcher.replicas,
            Stage::Mapper => self.mapper.replicas,
            Stage::DynamicCleaner => self.dynamic_cleaner.replicas,
            Stage::SyncManager => self.sync_manager.replicas,
        }
    }

    /// Sets the number of processes of a stage.
    pub fn set_replicas(&mut self, stage: Stage, replicas: usize) {
        *match stage {
            Stage::LidarIngest => &mut self.lidar_ingest.replicas,
            Stage::CorrelationFilter => &mut self.correlation_filter.replicas,
            Stage::ScanMatcher => &mut self.scan_matcher.replicas,
            Stage::Mapper => &mut self.mapper.replicas,
            Stage::DynamicCleaner => &mut self.dynamic_cleaner.replicas,
            Stage::SyncManager => &mut self.sync_manager.replicas,
        } = replicas;
    }

    fn check(&self) -> Result<(), ConfigurationError> {
        let wrong = |key: &str, reason: &str| ConfigurationError::Value {
            key: key.to_owned(),
            reason: reason.to_owned(),
        };
        self.lidar_ingest.check().map_err(|reason| wrong("lidar_ingest", reason))?;
        self.simulation.check().map_err(|reason| wrong("simulation", reason))?;
        self.sync_manager
            .flock
            .check()
            .map_err(|(key, reason)| wrong(&format!("sync_manager.flock.{key}"), reason))?;
        range::check(&Table::try_from(self).expect("a configuration can be written as TOML"))
            .map_err(|(key, reason)| wrong(&key, &reason))
    }
}

fn read_file(path: &Path) -> Result<Table, ConfigurationError> {
    parse_file::<Configuration>(path)?;
    parse_file(path)
}

/// A TOML file as a type that refuses unknown keys; old keys are refused with what became of them.
///
/// # Errors
/// When it cannot be read or is not of that type: with line, reason and a hint.
pub fn parse_file<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, ConfigurationError> {
    let unreadable = |source| ConfigurationError::Unreadable { path: path.to_owned(), source };
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    let wrong = |place: usize, reason: String| {
        let line = text[..place.min(text.len())].matches('\n').count() + 1;
        ConfigurationError::File { path: path.to_owned(), line, reason }
    };
    if let Some((place, text)) = old_keys::in_text(&text) {
        return Err(wrong(place, text));
    }
    toml::from_str(&text).map_err(|error: toml::de::Error| {
        wrong(error.span().map_or(0, |span| span.start), with_hint(error.message()))
    })
}

fn parse_assignment(assignment: &str) -> Result<Table, String> {
    let (key, text) = assignment.split_once('=').ok_or("write it as section.key=value")?;
    let mut parts: Vec<&str> = key.trim().split('.').collect();
    let last = parts.pop().filter(|part| !part.is_empty()).ok_or("write it as section.key=value")?;
    // What is no TOML value is a word: mode=off.
    let parsed =
        toml::from_str::<Table>(&format!("value = {text}")).ok().and_then(|mut table| table.remove("value"));
    let mut table = Table::from_iter([(
        last.to_owned(),
        parsed.unwrap_or_else(|| Value::String(text.trim().to_owned())),
    )]);
    for part in parts.into_iter().rev() {
        table = Table::from_iter([(part.to_owned(), Value::Table(table))]);
    }
    Ok(table)
}

fn merge(onto: &mut Table, from: Table) {
    for (key, value) in from {
        match (onto.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(table)) => merge(below, table),
            // A whole number is good where a number is asked for.
            (Some(old @ Value::Float(_)), Value::Integer(whole)) => *old = Value::Float(whole as f64),
            (_, value) => drop(onto.insert(key, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(assignment: &str) -> Result<Configuration, ConfigurationError> {
        Configuration::load(Profile::Default, None, &[assignment.to_owned()])
    }

    /// Appends an assignment of its present value for each key below `path`.
    fn assignments(path: &str, value: &Value, to: &mut Vec<String>) {
        match value {
            Value::Table(table) => {
                for (key, value) in table {
                    let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                    assignments(&path, value, to);
                }
            }
            value => to.push(format!("{path}={value}")),
        }
    }

    #[test]
    fn every_key_with_a_default_can_be_set_and_words_need_no_quotes() {
        let configuration = Configuration::default();
        let table = Table::try_from(&configuration).unwrap();
        let mut all = Vec::new();
        assignments("", &Value::Table(table.clone()), &mut all);
        assert!(all.len() > table.len(), "{all:?}");
        assert_eq!(Configuration::load(Profile::Default, None, &all).unwrap(), configuration);
        let off = set("correlation_filter.mode=off").unwrap().correlation_filter.mode;
        assert_eq!(off, flockslam_correlation_filter::Mode::Off);
        assert_eq!(set("mapper.cell_size_m=1").unwrap().mapper.cell_size_m, 1.0);
        assert_eq!(
            set("lidar_ingest.start_pose=[1, 2.5, 0]").unwrap().lidar_ingest.start_pose,
            Some([1.0, 2.5, 0.0])
        );
    }

    #[test]
    fn unknown_keys_and_bad_values_are_refused_with_a_hint() {
        let message = set("mapper.cel_size_m=0.1").unwrap_err().to_string();
        assert!(
            message.contains("cel_size_m") && message.contains("did you mean `cell_size_m`?"),
            "{message}"
        );
        assert!(set("maper.cell_size_m=0.1").unwrap_err().to_string().contains("did you mean `mapper`?"));
        assert!(set("mapper").is_err() && set("mapper.cell_size_m=wide").is_err() && set("=3").is_err());
        assert!(set("mapper.cell_size_m=0").unwrap_err().to_string().contains("mapper.cell_size_m"));
    }

    #[test]
    fn a_file_is_refused_with_its_line() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("robot.toml");
        std::fs::write(&path, "[mapper]\ncell_size_m = 0.1\n\n[scan_matcher]\nstrategie = \"ndt\"\n")
            .unwrap();
        let message = Configuration::load(Profile::Default, Some(&path), &[]).unwrap_err().to_string();
        assert!(
            message.contains("robot.toml:5: ") && message.contains("did you mean `strategy`?"),
            "{message}"
        );
        std::fs::write(&path, "[mapper]\ncell_size_m = 0.1\n").unwrap();
        let loaded =
            Configuration::load(Profile::Default, Some(&path), &["mapper.cell_size_m=0.2".to_owned()])
                .unwrap();
        assert_eq!(loaded.mapper.cell_size_m, 0.2);
        assert!(Configuration::load(Profile::Default, Some(Path::new("/no/such/file")), &[]).is_err());
    }

    #[test]
    fn a_configuration_survives_being_written_down() {
        for profile in [Profile::Default, Profile::Vinyslam, Profile::Ndt] {
            let configuration = Configuration::of_profile(profile);
            let json = serde_json::to_string(&configuration).unwrap();
            assert_eq!(serde_json::from_str::<Configuration>(&json).unwrap(), configuration);
        }
    }
}
