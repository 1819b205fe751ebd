//! Worlds that move: people, doors and pallets leave neither ghosts nor holes in the map that navigation reads.

mod support;

use flockslam_lidar_ingest::process::read_world;
use flockslam_lidar_ingest::simulation::{GroundTruth, Settings, World};
use std::path::Path;
use support::{MapFigures, Outputs};

/// Side of a cell of the map, metres.
const CELL_M: f64 = 0.045;

/// A drive through a world in which everything moves.
#[derive(Clone, Copy)]
struct Drive {
    world: Option<&'static str>,
    walkers: u32,
    seed: u64,
}

impl Drive {
    fn settings(&self) -> Settings {
        Settings {
            seed: self.seed,
            walkers: self.walkers,
            follower: true,
            doors: 6,
            pallets: 4,
            ..Settings::default()
        }
    }

    fn run(&self, out: &Path, more: &[&str]) -> Outputs {
        let settings = self.settings();
        let mut args = vec!["demo".to_owned()];
        if let Some(world) = self.world {
            args.extend(["--world".to_owned(), world.to_owned()]);
        }
        let set = [
            format!("simulation.seed={}", settings.seed),
            format!("simulation.walkers={}", settings.walkers),
            format!("simulation.follower={}", settings.follower),
            format!("simulation.doors={}", settings.doors),
            format!("simulation.pallets={}", settings.pallets),
        ];
        for assignment in set.iter().map(String::as_str).chain(more.iter().copied()) {
            args.extend(["--set".to_owned(), assignment.to_owned()]);
        }
        support::run_well("moving", out, &args)
    }

    fn truth(&self) -> GroundTruth {
        let world = self.world.map_or_else(World::floor_plan, |path| read_world(Path::new(path)).unwrap());
        GroundTruth::of_drive(&self.settings(), world, CELL_M).unwrap()
    }
}

#[test]
fn explore() {
    let maps = ["building_31", "stata_basement", "willow-2010-02-18-0.10"]
        .map(|m| format!("/work/shared/data/maps/{m}.yaml"));
    let seeds: u64 = std::env::var("SEEDS").map_or(1, |s| s.parse().unwrap());
    let more = std::env::var("MORE").unwrap_or_default();
    let more: Vec<&str> = more.split_whitespace().collect();
    for map in maps {
        let map: &'static str = Box::leak(map.into_boxed_str());
        for seed in 1..=seeds {
            for walkers in [0, 2, 20] {
                let drive = Drive { world: Some(map), walkers, seed };
                let truth = drive.truth();
                let directory = tempfile::tempdir().unwrap();
                let outputs = drive.run(directory.path(), &more);
                println!(
                    "{} seed {seed} walkers {walkers:2}: {} ATE {:.4}",
                    Path::new(map).file_stem().unwrap().display(),
                    MapFigures::of(&outputs, &truth),
                    support::truth_error_m(&outputs)
                );
            }
        }
    }
}
