//! `cargo bench -p flockslam --bench attached_drives -- MAP.yaml SECONDS SEEDS`: a map of nav2's kind is imported, and for each seed a set begins
//! somewhere in it that it does not know, with another drive. Prints how far its final poses are from the truth, in the frame of the map, and in
//! the end how many drives were put at a wrong place or at none. Drives are live, eight times as fast as a robot: a second run may differ.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_geometry::Pose;
use std::path::Path;
use support::plan_pictures::PlanPicture;
use support::{Drive, LiveSet, flockslam, truth_offsets_m};

/// A drive whose poses are off by more than this, in the mean, was put at a wrong place, metres.
const WRONG_M: f64 = 3.0;

fn main() {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let [map, seconds, seeds] = arguments.as_slice() else {
        println!("attached_drives needs MAP.yaml SECONDS SEEDS");
        return;
    };
    let (duration_s, seeds): (f64, u64) = (seconds.parse().expect("seconds"), seeds.parse().expect("seeds"));
    let map = Path::new(map).canonicalize().expect("a map");
    let (mut wrong, mut unattached) = (Vec::new(), Vec::new());
    for seed in 1..=seeds {
        let (mean_m, detached) = drive(&map, duration_s, seed);
        if detached > 0 {
            unattached.push(seed);
        } else if mean_m > WRONG_M {
            wrong.push(seed);
        }
    }
    println!("{seeds} drives: wrong {wrong:?}, not attached {unattached:?}");
}

/// Mean error of the final poses of a drive, metres, and its scans that were not attached to the map.
fn drive(map: &Path, duration_s: f64, seed: u64) -> (f64, u64) {
    let directory = tempfile::tempdir().expect("a directory");
    let kept = directory.path().join("kept");
    let imports = flockslam().args(["store", "import"]).arg(map).arg("--out").arg(&kept).status();
    assert!(imports.expect("the executable").success(), "the map is imported");
    let drive = Drive { scan_rate_hz: 10.0, duration_s, rate: 8.0 };
    let of_seed = ["--set".to_owned(), format!("simulation.seed={seed}")];
    let set = LiveSet::start_in_with(
        map,
        "attached",
        directory.path(),
        drive,
        &format!("map = {kept:?}"),
        &of_seed,
    );
    let outputs = set.finish();
    let plan = PlanPicture::read(map);
    let offsets_m = truth_offsets_m(&outputs, Pose::new(plan.origin.x_m, plan.origin.y_m, 0.0), 0.0);
    let mean_m = offsets_m.iter().sum::<f64>() / offsets_m.len() as f64;
    let greatest_m = offsets_m.iter().copied().fold(0.0, f64::max);
    let detached = outputs.report.detached_scans;
    println!("seed {seed}: error {mean_m:.3} m, at most {greatest_m:.2} m; {detached} scans not attached");
    (mean_m, detached)
}
