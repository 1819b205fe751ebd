//! `cargo bench -p flockslam --bench changed_starts -- STARTS [office|hotel|warehouse|campus|MAP.yaml …] [drawn]`: robots that are switched on at
//! unknown poses look for themselves in a map in which 30 % of the furniture has moved since, among 20 people; each drives up to 40 m. With
//! `drawn`, the map is a plan: it shows no furniture at all. What people hide is not matched. Prints how far each
//! had to drive, and each place that was false.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[path = "../support/plan_pictures.rs"]
mod plan_pictures;
#[path = "../support/start_trials.rs"]
mod start_trials;

use flockslam_evidence::{CellIndex, CellState};
use flockslam_geometry::Point;
use flockslam_lidar_ingest::process::read_world;
use flockslam_localisation::{KnownMap, Localizer, Surroundings};
use flockslam_loop_closure::scans::ScanStore;
use flockslam_messages::{BeamRange, ScanBuffer};
use flockslam_random::Random;
use flockslam_registration::cloud::Placement;
use flockslam_simulation::{BeamLabel, GroundTruth, Settings, Simulation, World, WorldName};
use plan_pictures::PlanPicture;
use start_trials::{StartTrial, start_trial};
use std::error::Error;
use std::path::Path;

/// Side of a cell of the worlds, metres.
const CELL_M: f64 = 0.05;
/// Share of the furniture that has moved, and people.
const MOVED: f64 = 0.3;
const PEOPLE: u32 = 20;
/// A piece of furniture for so much free space, m².
const PIECE_M2: f64 = 15.0;
/// What is found farther from the truth is false, metres and radians.
const FALSE: (f64, f64) = (0.5, 0.15);

/// A built-in world as its lidar sees it on a drive, or a map of nav2's kind; `None`: there is no such world.
fn picture(name: &str) -> Result<PlanPicture, Box<dyn Error>> {
    let (world, duration_s) = match name {
        "office" => (WorldName::Office, 300.0),
        "hotel" => (WorldName::Hotel, 1200.0),
        "warehouse" => (WorldName::Warehouse, 1200.0),
        "campus" => (WorldName::Campus, 3000.0),
        yaml => return Ok(PlanPicture::read(Path::new(yaml))),
    };
    let settings = Settings { world, duration_s, beams: 720, ..Settings::default() };
    let truth = GroundTruth::of_drive(&settings, World::built_in(&settings), CELL_M)?;
    let cells: Vec<(CellIndex, bool)> =
        truth.cells().map(|(index, cell)| (index, cell.is_static())).collect();
    let bounds = |of: fn(&CellIndex) -> i32| {
        let along = cells.iter().map(|(index, _)| of(index));
        (along.clone().min().unwrap_or(0), along.max().unwrap_or(0))
    };
    let ((left, right), (low, high)) = (bounds(|index| index.x), bounds(|index| index.y));
    let (width, height) = ((right - left + 1) as usize, (high - low + 1) as usize);
    let mut states = vec![CellState::Unknown; width * height];
    for (index, is_static) in cells {
        let place = (index.y - low) as usize * width + (index.x - left) as usize;
        states[place] = if is_static { CellState::Occupied } else { CellState::Free };
    }
    Ok(PlanPicture { width, height, cell_size_m: CELL_M, origin: Point::new(0.0, 0.0), cells: states })
}

fn main() -> Result<(), Box<dyn Error>> {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let Some(starts) = arguments.first().and_then(|starts| starts.parse::<usize>().ok()) else {
        println!("changed_starts needs STARTS [office|hotel|warehouse|campus|MAP.yaml …] [drawn]");
        return Ok(());
    };
    let is_drawn = arguments.iter().any(|argument| argument == "drawn");
    let given: Vec<&str> =
        arguments[1..].iter().map(String::as_str).filter(|name| *name != "drawn").collect();
    let all = ["office", "hotel", "warehouse", "campus"];
    for name in if given.is_empty() { &all[..] } else { &given } {
        println!("{name}: {}", trials(name, starts, is_drawn)?);
    }
    Ok(())
}

fn trials(name: &str, starts: usize, is_drawn: bool) -> Result<String, Box<dyn Error>> {
    let mut random = Random::new(1, "changed starts");
    let empty = PlanPicture { origin: Point::new(0.0, 0.0), ..picture(name)? };
    let (before, furniture) = empty.clone().furnished((empty.free_m2() / PIECE_M2) as usize, &mut random);
    let mut kept = empty.clone();
    furniture.iter().filter(|_| !random.happens(MOVED)).for_each(|piece| kept.put(piece));
    let moved = furniture.iter().filter(|piece| !kept.has(piece)).count();
    let (now, _) = kept.furnished(moved, &mut random);
    let known = if is_drawn { &empty } else { &before };
    let mut map = KnownMap::of_width(known.width, known.cell_size_m, known.origin);
    known.cells.chunks_exact(known.width).for_each(|row| map.push_row(row.iter().copied()));
    let mut localizer = Localizer::new(Surroundings::new(map.measured()));
    // Each drive is long enough for ten starts.
    let mut all = Vec::new();
    let directory = tempfile::tempdir()?;
    let world = read_world(&now.write(directory.path(), "now"))?;
    for seed in 1..=starts.div_ceil(10) as u64 {
        let settings = Settings {
            seed,
            walkers: PEOPLE,
            duration_s: 250.0,
            world: if name == "campus" { WorldName::Campus } else { WorldName::Office },
            ..Settings::default()
        };
        let mut simulation = Simulation::new(&settings, world.clone())?;
        let (mut scan, mut store) = (ScanBuffer::default(), ScanStore::default());
        let (mut way, mut scans) = (Vec::new(), Vec::new());
        while let Some(truth) = simulation.next_scan(&mut scan) {
            way.push(Placement::from(truth));
            let twist = simulation.twist();
            // The front end does not match what moves.
            let moving = moving(simulation.labels());
            scans.push(store.keep(scan.view()?, twist, &moving, false));
        }
        for k in 0..10.min(starts - all.len()) {
            let first = way.len() * k / 10;
            all.push(start_trial(&mut localizer, &way[first..], &scans[first..], &store, Some(FALSE)));
        }
    }
    for trial in &all {
        if let Some((truth, found)) = trial.false_place {
            println!("FALSE: at {truth:?} said to be at {found:?} after {:?} m", trial.found_after_m);
        }
    }
    Ok(summary(&all, &now))
}

/// The beams on people, in order.
fn moving(labels: &[BeamLabel]) -> Vec<BeamRange> {
    let on_people = labels.iter().enumerate().filter(|(_, label)| **label == BeamLabel::MotionState);
    on_people.map(|(beam, _)| BeamRange { first: beam as u32, end: beam as u32 + 1 }).collect()
}

fn summary(trials: &[StartTrial], world: &PlanPicture) -> String {
    let sorted = |mut numbers: Vec<f64>| {
        numbers.sort_by(f64::total_cmp);
        numbers
    };
    let quantile =
        |numbers: &[f64], share: f64| numbers.get((share * numbers.len() as f64) as usize).copied();
    let found_m = sorted(trials.iter().filter_map(|trial| trial.found_after_m).collect());
    let errors_m: Vec<f64> = trials.iter().flat_map(|trial| trial.errors_m.iter().copied()).collect();
    let agreements: Vec<_> = trials.iter().flat_map(|trial| &trial.at_truth).collect();
    let explained = sorted(agreements.iter().map(|agreement| agreement.explained).collect());
    let contradicted = sorted(agreements.iter().map(|agreement| agreement.contradicted).collect());
    let count = |is: fn(&StartTrial) -> bool| trials.iter().filter(|trial| is(trial)).count();
    format!(
        "{:.0} m²; {} starts: {} found after p50 {:.1?} m, p95 {:.1?} m; {} false, {} lost again, {} not found, of these {} ambiguous; error {:.3} m in the mean; at the truth p10 {:.2?} explained, p90 {:.2?} contradicted; slowest step {:.2?}",
        world.free_m2(),
        trials.len(),
        found_m.len(),
        quantile(&found_m, 0.5),
        quantile(&found_m, 0.95),
        count(|trial| trial.false_place.is_some()),
        count(|trial| trial.was_lost),
        count(|trial| trial.found_after_m.is_none()),
        count(|trial| trial.found_after_m.is_none() && trial.was_ambiguous),
        errors_m.iter().sum::<f64>() / errors_m.len().max(1) as f64,
        quantile(&explained, 0.1),
        quantile(&contradicted, 0.9),
        trials.iter().map(|trial| trial.slowest).max().unwrap_or_default(),
    )
}
