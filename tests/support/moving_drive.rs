//! Drives through simulated worlds in which something moves.

use super::{MapFigures, Outputs, data_dir, run_well, truth_error_m};
use flockslam_lidar_ingest::process::read_world;
use flockslam_simulation::{GroundTruth, Settings, World};
use std::path::PathBuf;

/// Side of a cell of the map, metres.
const CELL_M: f64 = 0.045;
/// Settings under which everything that was ever seen stays in the map.
pub const UNCLEANED: [&str; 3] =
    ["dynamic_cleaner.enabled=false", "mapper.confirming_scans=1", "sync_manager.clear_at_end=false"];
/// Real buildings.
pub const BUILDINGS: [&str; 3] = ["building_31", "stata_basement", "willow-2010-02-18-0.10"];

/// A drive through a world in which something moves.
pub struct MovingDrive {
    /// The map of a building; none: the office.
    pub map: Option<PathBuf>,
    pub settings: Settings,
}

/// What a run has left, as long as it is needed.
pub struct MovingRun {
    pub outputs: Outputs,
    _directory: tempfile::TempDir,
}

impl MovingRun {
    /// ATE, metres.
    pub fn error_m(&self) -> f64 {
        truth_error_m(&self.outputs)
    }
}

impl MovingDrive {
    /// Runs it with more settings.
    pub fn run(&self, more: &[&str]) -> MovingRun {
        let Settings { seed, walkers, follower, doors, pallets, duration_s, .. } = self.settings;
        let mut args = vec!["demo".to_owned()];
        args.extend(self.map.iter().flat_map(|map| ["--world".to_owned(), map.display().to_string()]));
        let set = [
            format!("simulation.seed={seed}"),
            format!("simulation.duration_s={duration_s:?}"),
            format!("simulation.walkers={walkers}"),
            format!("simulation.follower={follower}"),
            format!("simulation.doors={doors}"),
            format!("simulation.pallets={pallets}"),
        ];
        for assignment in set.iter().map(String::as_str).chain(more.iter().copied()) {
            args.extend(["--set".to_owned(), assignment.to_owned()]);
        }
        let directory = tempfile::tempdir().unwrap();
        let outputs = run_well("moving", directory.path(), &args);
        MovingRun { outputs, _directory: directory }
    }

    /// Figures of the map of a run, beside a run that cleans nothing.
    pub fn figures(&self, run: &MovingRun) -> MapFigures {
        let world = self.map.as_ref().map_or_else(World::floor_plan, |path| read_world(path).expect("a map"));
        let truth = GroundTruth::of_drive(&self.settings, world, CELL_M).unwrap();
        MapFigures::of(&run.outputs, &self.run(&UNCLEANED).outputs, &truth)
    }
}

/// A drive among people, doors and pallets.
pub fn with_movers(seed: u64, walkers: u32) -> Settings {
    Settings { seed, walkers, doors: 6, pallets: 4, ..Settings::default() }
}

/// The map of a real building, where the data are.
pub fn moving_building(name: &str) -> Option<PathBuf> {
    Some(data_dir()?.join("maps").join(format!("{name}.yaml")))
}
