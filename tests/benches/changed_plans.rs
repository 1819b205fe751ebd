//! AMCL's case: `cargo bench -p flockslam --bench changed_plans -- MAP.yaml SECONDS SEEDS [walls|doors|furniture …]`. Drives are simulated in a
//! building that has changed since its map was drawn, a map of nav2's kind, and localized in the map: walls stand a pixel elsewhere, half of
//! the doors are closed, furniture stands where the map shows none. Prints the errors of all poses since the robot was found, and how often it was lost.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_geometry::Pose;
use flockslam_random::Random;
use std::path::Path;
use support::plan_pictures::PlanPicture;
use support::{run_well, truth_offsets_m};

/// A piece of furniture for so much space that is known to be free, m².
const PIECE_M2: f64 = 15.0;
/// Walls move in pieces of this length, metres: the frame of the map stays what the building says in the mean.
const WALL_M: f64 = 4.0;
/// The robot is to be found within this, seconds.
const FOUND_S: f64 = 30.0;

fn main() {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let [map, seconds, seeds, changes @ ..] = arguments.as_slice() else {
        println!("changed_plans needs MAP.yaml SECONDS SEEDS [walls|doors|furniture …]");
        return;
    };
    let (seconds, seeds): (u32, u64) = (seconds.parse().expect("seconds"), seeds.parse().expect("seeds"));
    let plan = PlanPicture::read(Path::new(map));
    let all = [vec![], vec!["walls"], vec!["doors"], vec!["walls", "doors"], vec!["furniture"]];
    let given: Vec<&str> = changes.iter().map(String::as_str).collect();
    let wanted = if given.is_empty() { all.to_vec() } else { vec![given] };
    for changes in &wanted {
        for seed in 1..=seeds {
            println!("{changes:?}, seed {seed}: {}", drive(&plan, changes, seconds, seed));
        }
    }
}

/// The plan as a building in which these things have changed.
fn changed(plan: &PlanPicture, changes: &[&str], seed: u64) -> PlanPicture {
    let mut random = Random::new(seed, "changed plans");
    let mut world = plan.clone();
    for change in changes {
        world = match *change {
            "walls" => world.with_walls_off(WALL_M, &mut random),
            "doors" => world.with_doors_closed(0.5, &mut random).0,
            "furniture" => {
                let pieces = (world.free_m2() / PIECE_M2) as usize;
                world.furnished(pieces, &mut random).0
            }
            other => panic!("{other} is no change"),
        };
    }
    world
}

fn drive(plan: &PlanPicture, changes: &[&str], seconds: u32, seed: u64) -> String {
    let directory = tempfile::tempdir().expect("a directory");
    let [known, world] =
        [plan.write(directory.path(), "plan"), changed(plan, changes, seed).write(directory.path(), "world")];
    let [known, world] = [known, world].map(|path| path.display().to_string());
    let mut args = vec!["demo".to_owned(), "--world".to_owned(), world, "--localize".to_owned(), known];
    let settings = [format!("simulation.duration_s={seconds}"), format!("simulation.seed={seed}")];
    settings.into_iter().for_each(|setting| args.extend(["--set".to_owned(), setting]));
    let outputs = run_well("changed", &directory.path().join("out"), &args);
    let found = outputs.report.localisation.expect("the set localizes");
    let plan_from_world = Pose::new(plan.origin.x_m, plan.origin.y_m, 0.0);
    let offsets_m = truth_offsets_m(&outputs, plan_from_world, FOUND_S);
    let mean_m = offsets_m.iter().sum::<f64>() / offsets_m.len() as f64;
    let greatest_m = offsets_m.iter().copied().fold(0.0, f64::max);
    format!(
        "{:.0} m driven, found after {:.1?} m, {} times, {} of {} scans localized; error {mean_m:.3} m, at most {greatest_m:.2} m",
        outputs.report.trajectory_length_m,
        found.found_after_m,
        found.found,
        found.localized_scans,
        found.localized_scans + found.unlocalized_scans,
    )
}
