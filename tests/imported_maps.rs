//! A map of somebody else becomes a saved map: it is exported as it was drawn, a set goes on with it, and its frame stays the frame.

use crate::support::plan_pictures::PlanPicture;
use crate::support::{
    Drive, LiveSet, Outputs, building, data_dir, flockslam, is_localized, machine_share, run_well, stderr,
    truth_offsets_m,
};
use flockslam::store::SavedMap;
use flockslam_evidence::CellState;
use flockslam_geometry::Pose;
use flockslam_results::SubmapStore;
use std::fs;
use std::path::Path;

/// Slow enough that a busy machine takes all scans: the poses of such that are passed over err by decimetres.
const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 240.0, rate: 2.0 };

fn store(order: &str, from: &Path, out: &Path) {
    let output = flockslam().args(["store", order]).arg(from).arg("--out").arg(out).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

/// The bytes of the first so many submaps of a saved map.
fn submaps(map: &Path, count: u32) -> Vec<Vec<u8>> {
    let store = SubmapStore::new(&map.join("submaps"));
    (0..count).map(|number| fs::read(store.file(number)).unwrap()).collect()
}

/// Of the cells that a plan has in a state, the share that another has in it, and the share that it has in the opposite one.
fn shares(plan: &PlanPicture, other: &PlanPicture, state: CellState) -> (f64, f64) {
    let (mut all, mut same, mut opposite) = (0, 0, 0);
    for (place, _) in plan.cells.iter().enumerate().filter(|(_, cell)| **cell == state) {
        let cell = other.state_at(plan.middle(place));
        all += 1;
        same += i32::from(cell == state);
        opposite += i32::from(cell != state && cell != CellState::Unknown);
    }
    (f64::from(same) / f64::from(all), f64::from(opposite) / f64::from(all))
}

/// Mean and greatest distance of the final poses from the truth, without so many at first, metres; `plan_from_world` is where the world is.
fn error_in_plan(outputs: &Outputs, plan_from_world: Pose, skipped_scans: usize) -> (f64, f64) {
    let offsets_m = &truth_offsets_m(outputs, plan_from_world, 0.0)[skipped_scans..];
    let sum_m: f64 = offsets_m.iter().sum();
    (sum_m / offsets_m.len() as f64, offsets_m.iter().copied().fold(0.0, f64::max))
}

#[test]
fn a_map_that_is_imported_is_exported_cell_by_cell_as_it_was_drawn() {
    let directory = tempfile::tempdir().unwrap();
    let [known, imported, exported] =
        ["known", "imported", "exported"].map(|name| directory.path().join(name));
    run_well("drawn", &known, &building(40));
    store("import", &known.join("map.yaml"), &imported);
    let found = SavedMap::at(&imported).check().unwrap();
    println!("{found:?}");
    assert!(found.problems.is_empty() && found.submaps > 0 && found.poses == found.accepted);
    store("export", &imported, &exported);
    let [plan, again] = [&known, &exported].map(|map| PlanPicture::read(&map.join("map.yaml")));
    for state in [CellState::Occupied, CellState::Free, CellState::Unknown] {
        assert_eq!(shares(&plan, &again, state), (1.0, 0.0), "{state:?}");
    }
    let mut again = flockslam();
    let taken = again.args(["store", "import"]).arg(known.join("map.yaml")).arg("--out").arg(&imported);
    let taken = taken.output().unwrap();
    assert_eq!(taken.status.code(), Some(2));
    assert!(stderr(&taken).lines().count() == 1 && stderr(&taken).contains("another directory"));
}

#[test]
fn half_of_an_office_that_is_imported_is_mapped_on_from_an_unknown_place_in_its_own_frame() {
    machine_share::mostly_waits();
    let directory = tempfile::tempdir().unwrap();
    let [known, kept, exported] = ["known", "kept", "exported"].map(|name| directory.path().join(name));
    let whole = run_well("office", &known, &building(240));
    // The map of the office is where its first drive began.
    let plan_from_world = whole.frame_from_truth();
    let of_whole = error_in_plan(&whole, plan_from_world, 0);
    let plan = PlanPicture::read(&known.join("map.yaml")).without_left(0.5);
    store("import", &plan.write(directory.path(), "plan"), &kept);
    let count = SavedMap::at(&kept).check().unwrap().submaps;
    let before = submaps(&kept, count);
    let other = ["--set", "simulation.seed=2"].map(str::to_owned);
    let keeps = format!("map = {kept:?}\nsave_every_s = 0.5");
    let outputs =
        LiveSet::start_with_failpoints("half", directory.path(), DRIVE, &keeps, &other, "").finish();
    let report = &outputs.report;
    let error = error_in_plan(&outputs, plan_from_world, 0);
    println!(
        "mapped {of_whole:?} m, mapped on {error:?} m from the truth, mean and greatest; {} scans apart; {:.0} of {:.0} m²",
        report.detached_scans, report.map_area_m2, whole.report.map_area_m2
    );
    assert_eq!((report.trajectories, report.detached_scans), (2, 0));
    assert!(before == submaps(&kept, count), "imported submaps have changed");
    assert!(SavedMap::at(&kept).check().unwrap().submaps > count + 2);
    store("export", &kept, &exported);
    let both = PlanPicture::read(&exported.join("map.yaml"));
    let (walls, free) = (shares(&plan, &both, CellState::Occupied), shares(&plan, &both, CellState::Free));
    println!("of the plan's walls and of its free space the same and the opposite: {walls:?}, {free:?}");
    assert!(error.0 < 0.05 && error.1 < 0.25, "{error:?}");
    assert!(report.map_area_m2 > 0.9 * whole.report.map_area_m2);
    assert!(walls.0 > 0.85 && free.0 > 0.97, "{walls:?} {free:?}");
}

#[test]
fn a_nav2_map_that_is_imported_is_localized_in_and_then_mapped_on_in_its_own_frame() {
    let Some(data) = data_dir() else { return };
    machine_share::computes();
    let directory = tempfile::tempdir().unwrap();
    let [imported, longer, exported] =
        ["imported", "longer", "exported"].map(|name| directory.path().join(name));
    let yaml = data.join("maps/building_31.yaml");
    let plan = PlanPicture::read(&yaml);
    store("import", &yaml, &imported);
    let count = SavedMap::at(&imported).check().unwrap().submaps;
    let localizes = format!("localize = {imported:?}");
    let mut set = LiveSet::start_in(&yaml, "nav2", directory.path(), DRIVE, &localizes);
    let found = set.wait_until("the robot is localized", is_localized).localisation;
    set.command_well(&["mode", "map"]);
    let begun = set.wait_until("a map is made", |status| status.mode.name == "map");
    let handled = begun.stages.iter().map(|stage| stage.handled).max().unwrap();
    set.wait_until_handled(flockslam_messages::Stage::SyncManager, handled + 1000);
    set.command_well(&["store", "save", longer.to_str().unwrap()]);
    let outputs = set.finish();
    let plan_from_world = Pose::new(plan.origin.x_m, plan.origin.y_m, 0.0);
    // Nobody knows where the robot was before it is found, and how long that takes depends on what else runs.
    let error = error_in_plan(&outputs, plan_from_world, handled as usize);
    println!(
        "localized: {found:?}; mapping after {handled} scans; {error:?} m from the truth, mean and greatest; {report:?}",
        report = outputs.report
    );
    assert!(error.0 < 0.05 && error.1 < 0.25, "{error:?}");
    assert!(submaps(&imported, count) == submaps(&longer, count), "imported submaps have changed");
    assert!(SavedMap::at(&longer).check().unwrap().submaps > count + 2);
    store("export", &longer, &exported);
    let both = PlanPicture::read(&exported.join("map.yaml"));
    let (walls, free) = (shares(&plan, &both, CellState::Occupied), shares(&plan, &both, CellState::Free));
    println!("of the plan's walls and of its free space the same and the opposite: {walls:?}, {free:?}");
    assert!(walls.0 > 0.85 && free.0 > 0.97, "{walls:?} {free:?}");
}
