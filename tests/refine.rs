//! `flockslam map --refine`: the run itself stays what it is; beside it come a refined trajectory and a second epoch of submaps.

use crate::support::{Outputs, run_well, simulated_log, truth_error_m};
use flockslam::epoch::{ORIGINALS, REFINED};
use flockslam::outputs::map_hash;
use flockslam_evidence::FusedMap;
use flockslam_geometry::Pose;
use flockslam_stage::SubmapStore;
use flockslam_stage::results::{StoredMap, read_layout};

/// The submaps of an epoch at the places that `place` gives them, by number; a submap without one is left out.
fn sum_of(outputs: &Outputs, epoch: &str, place: impl Fn(u32) -> Option<Pose>) -> (u32, StoredMap) {
    let store = SubmapStore::new(&outputs.directory.join("submaps").join(epoch));
    let mut map: Option<FusedMap> = None;
    for number in 0..store.count() {
        let submap = store.load(number).unwrap();
        let Some(map_from_odom) = place(number) else { continue };
        let map = map.get_or_insert_with(|| FusedMap::new(submap.cell_size_m));
        map.add(&submap, map_from_odom * submap.odom_from_submap).unwrap();
    }
    (store.count(), StoredMap::of(&map.unwrap()))
}

#[test]
fn a_refined_run_keeps_the_run_and_adds_to_it() {
    let directory = tempfile::tempdir().unwrap();
    let log = directory.path().join("building.log");
    std::fs::write(&log, simulated_log(150.0)).unwrap();
    let out = |name: &str| directory.path().join(name);
    let args = |more: &[&str]| {
        ["map", log.to_str().unwrap()].iter().chain(more).map(|arg| (*arg).to_owned()).collect::<Vec<_>>()
    };
    let plain = run_well("plain", &out("plain"), &args(&[]));
    let refined = run_well("refined", &out("refined"), &args(&["--refine"]));
    for name in ["trajectory.tum", "trajectory_online.tum"] {
        assert!(plain.bytes(name) == refined.bytes(name), "{name} differs");
    }
    assert!(plain.bytes("trajectory.tum") != refined.bytes("trajectory_refined.tum"));
    assert_eq!(plain.stamps("trajectory.tum"), refined.stamps("trajectory_refined.tum"));
    assert!(!out("plain").join("submaps").exists());

    // The originals at the places of the final layout, summed from scratch, are the map that the plain run kept as it went.
    let layout = read_layout(&out("refined").join("submaps").join(ORIGINALS)).unwrap();
    let place = |number| {
        let row = layout.iter().find(|row| row.number == number)?;
        let [x_m, y_m, heading_rad] = row.map_from_odom;
        Some(Pose { x_m, y_m, heading_rad })
    };
    let (count, originals) = sum_of(&refined, ORIGINALS, place);
    assert!(u64::from(count) == plain.report.submaps && count > 10, "{count}");
    assert_eq!(map_hash(&originals), plain.report.map_hash);

    // The second epoch lies in the frame of the map.
    let (count, second) = sum_of(&refined, REFINED, |_| Some(Pose::IDENTITY));
    assert!(count.abs_diff(plain.report.submaps as u32) <= 2, "{count}");
    assert_eq!(map_hash(&second), refined.report.map_hash);
    assert!((refined.report.map_area_m2 / plain.report.map_area_m2 - 1.0).abs() < 0.05);

    // Once more, into the same directory.
    let again = run_well("again", &out("refined"), &args(&["--refine"]));
    assert_eq!(again.report.map_hash, refined.report.map_hash);
    assert_eq!(sum_of(&again, REFINED, |_| Some(Pose::IDENTITY)).0, count);

    // And without: nothing is left that would belong to another run.
    run_well("unrefined", &out("refined"), &args(&[]));
    assert!(
        !out("refined").join("submaps").exists() && !out("refined").join("trajectory_refined.tum").exists()
    );
}

#[test]
fn a_refined_trajectory_is_as_good_as_the_final_one() {
    let directory = tempfile::tempdir().unwrap();
    // Long enough to come round: before that both are as good as the chain.
    let args = ["demo", "--set", "simulation.duration_s=250", "--set", "sync_manager.refine=true"];
    let mut outputs = run_well("demo", directory.path(), &args.map(str::to_owned));
    let last_m = truth_error_m(&outputs);
    std::fs::copy(directory.path().join("trajectory_refined.tum"), directory.path().join("trajectory.tum"))
        .unwrap();
    outputs = Outputs::read(&outputs.directory);
    let refined_m = truth_error_m(&outputs);
    assert!(refined_m < last_m + 0.002, "{refined_m} m, {last_m} m before");
}
