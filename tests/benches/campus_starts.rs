//! `cargo bench -p flockslam --bench campus_starts -- STARTS`: a robot maps a campus of 50 000 m² on a drive of 2600 s; others are
//! switched on along its tour, and as many on another campus, and look for themselves in that map while they drive for 60 s. Prints for each
//! how far it drove until it was found, how many scans were localized, and how far those were from the truth.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use std::path::Path;
use support::{Outputs, building, run_well};

/// Seconds of the drive that makes the map, and of those that are localized in it.
const DURATIONS_S: (u32, u32) = (2600, 60);
/// The map is bent by up to 1.2 m against the truth. What is found farther from it is false, metres.
const FALSE_M: f64 = 2.5;

/// A drive over a campus of its own seed.
fn drive(duration_s: u32, world_seed: u64, seed: u64, lead_s: u32) -> Vec<String> {
    let keys = [
        "world=campus".to_owned(),
        format!("world_seed={world_seed}"),
        format!("seed={seed}"),
        format!("lead_s={lead_s}"),
        "beams=360".to_owned(),
        "range_max_m=40".to_owned(),
        "wheel_slips=0".to_owned(),
    ];
    let mut args = building(duration_s);
    args.extend(keys.into_iter().flat_map(|key| ["--set".to_owned(), format!("simulation.{key}")]));
    args
}

/// Way until the robot was found, metres; scans that were localized; median distance of final poses from the truth, metres.
fn start(map: &Outputs, at: &Path, world_seed: u64, number: u64, lead_s: u32) -> (Option<f64>, u64, f64) {
    let mut args = drive(DURATIONS_S.1, world_seed, number + 2, lead_s);
    args.extend(["--localize".to_owned(), map.directory.display().to_string()]);
    let outputs = run_well("campus-starts", at, &args);
    let localisation = outputs.report.localisation.as_ref().expect("a set that localizes reports it");
    let map_from_truth = map.frame_from_truth();
    let mut errors_m: Vec<f64> = outputs
        .with_truth()
        .iter()
        .map(|(pose, truth)| map_from_truth.compose(truth.map_from_base).distance_m(pose.map_from_base))
        .collect();
    errors_m.sort_by(f64::total_cmp);
    (localisation.found_after_m, localisation.localized_scans, errors_m[errors_m.len() / 2])
}

fn main() {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let Some(starts) = arguments.first().and_then(|starts| starts.parse::<u32>().ok()) else {
        println!("campus_starts needs STARTS");
        return;
    };
    let directory = tempfile::tempdir().unwrap();
    let map = run_well("campus-map", &directory.path().join("map"), &drive(DURATIONS_S.0, 1, 1, 0));
    for world_seed in [1, 2] {
        let (mut found_m, mut wrong) = (Vec::new(), 0);
        for number in 0..starts {
            let lead_s = DURATIONS_S.0 * number / starts;
            let out = directory.path().join(format!("{world_seed}-{number}"));
            let (after_m, localized, error_m) = start(&map, &out, world_seed, u64::from(number), lead_s);
            println!(
                "campus {world_seed}, from {lead_s} s: found after {after_m:.1?} m, {localized} scans localized, {error_m:.2} m off"
            );
            wrong += u32::from(after_m.is_some() && (world_seed != 1 || error_m > FALSE_M));
            found_m.extend(after_m);
        }
        found_m.sort_by(f64::total_cmp);
        let quantile = |share: f64| found_m.get((share * found_m.len() as f64) as usize);
        println!(
            "campus {world_seed}: {} of {starts} found after p50 {:.1?} m, p95 {:.1?} m; {wrong} false",
            found_m.len(),
            quantile(0.5),
            quantile(0.95)
        );
    }
}
