//! `cargo bench -p flockslam --bench campus_starts -- STARTS`: a robot maps a campus of 50 000 m² on a drive of 2600 s; others are
//! switched on along its tour, and as many on another campus, and look for themselves in that map while they drive for 60 s. Prints for each
//! how far it drove until it was found, how many scans were localized, and how far all of its final poses are from the truth: in the frame
//! of the whole map, and in the map as it is there, by the pose of the mapping drive nearest to each.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
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

/// What a robot has found.
struct Found {
    /// Way until then, metres.
    after_m: Option<f64>,
    localized_scans: u64,
    /// Median distance of final poses from the truth in the frame of the whole map, metres.
    error_m: f64,
    /// The same in the map as it is there.
    from_map_m: f64,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Where the map shows a place of the world: beside the nearest pose of the drive that made it.
fn shown(map: &[(TrajectoryPoint, TrajectoryPoint)], truth: Pose) -> Pose {
    let distance_m = |of: &(TrajectoryPoint, TrajectoryPoint)| of.1.map_from_base.distance_m(truth);
    let nearest = map.iter().min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)));
    let (pose, nearest) = nearest.expect("a map has poses");
    pose.map_from_base.compose(nearest.map_from_base.inverse().compose(truth))
}

fn start(map: &Outputs, at: &Path, world_seed: u64, number: u64, lead_s: u32) -> Found {
    let mut args = drive(DURATIONS_S.1, world_seed, number + 2, lead_s);
    args.extend(["--localize".to_owned(), map.directory.display().to_string()]);
    let outputs = run_well("campus-starts", at, &args);
    let localisation = outputs.report.localisation.as_ref().expect("a set that localizes reports it");
    let map_from_truth = map.frame_from_truth();
    let (poses, of_map) = (outputs.with_truth(), map.with_truth());
    let errors_m = poses
        .iter()
        .map(|(pose, truth)| map_from_truth.compose(truth.map_from_base).distance_m(pose.map_from_base));
    let from_map_m =
        poses.iter().map(|(pose, truth)| shown(&of_map, truth.map_from_base).distance_m(pose.map_from_base));
    Found {
        after_m: localisation.found_after_m,
        localized_scans: localisation.localized_scans,
        error_m: median(errors_m.collect()),
        from_map_m: median(from_map_m.collect()),
    }
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
        let (mut found_m, mut errors_m, mut from_map_m, mut wrong) = (Vec::new(), Vec::new(), Vec::new(), 0);
        for number in 0..starts {
            let lead_s = DURATIONS_S.0 * number / starts;
            let out = directory.path().join(format!("{world_seed}-{number}"));
            let found = start(&map, &out, world_seed, u64::from(number), lead_s);
            println!(
                "campus {world_seed}, from {lead_s} s: found after {:.1?} m, {} scans localized, {:.2} m off, {:.3} m in the map there",
                found.after_m, found.localized_scans, found.error_m, found.from_map_m
            );
            wrong += u32::from(found.after_m.is_some() && (world_seed != 1 || found.error_m > FALSE_M));
            if let Some(after_m) = found.after_m {
                found_m.push(after_m);
                errors_m.push(found.error_m);
                from_map_m.push(found.from_map_m);
            }
        }
        let found = found_m.len();
        let quantiles = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            [0.5, 0.95, 1.0]
                .map(|share| values.get(((share * found as f64) as usize).min(found.max(1) - 1)).copied())
        };
        println!(
            "campus {world_seed}: {found} of {starts} found after {:.1?} m (p50, p95, most); {wrong} false; off {:.2?} m, in the map there {:.3?} m",
            quantiles(found_m),
            quantiles(errors_m),
            quantiles(from_map_m)
        );
    }
}
