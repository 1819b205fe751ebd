//! Exact replay of the simulated building: the same bytes every time, nothing lost, nothing left behind, and outputs
//! that other programs can read.

use crate::support;
use crate::support::{Outputs, building, run_well, truth_error_m};
use std::path::Path;
use std::sync::LazyLock;

const DURATION_S: u32 = 40;
const SCANS: usize = 400;
/// Error of a final trajectory, root mean square, metres.
const ERROR_MAX_M: f64 = 0.10;
const REPEATED: [&str; 5] = ["trajectory.tum", "trajectory_online.tum", "truth.tum", "map.pgm", "map.yaml"];

fn replay(directory: &Path) -> Outputs {
    run_well("replay", directory, &building(DURATION_S))
}

/// The outputs of one replay, which several tests read; the next run of the tests writes them anew.
fn outputs() -> &'static Outputs {
    static REPLAYED: LazyLock<Outputs> = LazyLock::new(|| {
        let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("runs/replay");
        let _ = std::fs::remove_dir_all(&out);
        std::fs::create_dir_all(out.parent().unwrap()).unwrap();
        replay(&out)
    });
    &REPLAYED
}

#[test]
fn ten_replays_give_the_same_bytes() {
    let first = outputs();
    for _ in 1..10 {
        let directory = tempfile::tempdir().unwrap();
        let again = replay(directory.path());
        for name in REPEATED {
            assert!(first.bytes(name) == again.bytes(name), "{name} differs");
        }
        assert_eq!(first.report.map_hash, again.report.map_hash);
    }
    println!("{:.0} scans/s in the first of ten replays", first.report.scans_per_s);
}

#[test]
fn another_seed_gives_another_map_and_a_trajectory_that_is_true_as_well() {
    let directory = tempfile::tempdir().unwrap();
    let mut other = building(DURATION_S);
    other.extend(["--set".to_owned(), "simulation.seed=2".to_owned()]);
    let (first, second) = (outputs(), run_well("seed", directory.path(), &other));
    assert_ne!(first.report.map_hash, second.report.map_hash);
    let error_m = truth_error_m(&second);
    println!("error against the truth with another seed: {error_m:.4} m");
    assert!(error_m < ERROR_MAX_M, "{error_m} m");
}

#[test]
fn every_scan_has_its_line_in_order_and_the_final_trajectory_is_true() {
    let outputs = outputs();
    let expected: Vec<_> = (0..SCANS).map(|i| format!("{}.{}00000", i / 10, i % 10)).collect();
    for name in ["trajectory.tum", "trajectory_online.tum", "truth.tum"] {
        assert_eq!(outputs.stamps(name), expected, "{name}");
        assert!(outputs.lines(name).iter().all(|line| line.split(' ').count() == 8), "{name}");
    }
    let error_m = truth_error_m(outputs);
    println!("final trajectory: {error_m:.4} m against the truth (rms)");
    assert!(error_m < ERROR_MAX_M, "{error_m} m");
}

#[test]
fn the_report_has_the_documented_fields() {
    let outputs = outputs();
    let report: serde_json::Value = serde_json::from_slice(&outputs.bytes("report.json")).unwrap();
    assert_eq!(report["version"], flockslam::VERSION);
    assert_eq!(report["scans"], SCANS);
    let count = |field: &serde_json::Value| {
        field.as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum::<u64>()
    };
    assert_eq!(report["kept"].as_u64().unwrap() + count(&report["dropped"]), SCANS as u64);
    assert_eq!(count(&report["rejected"]), 0);
    let positive = |value: &serde_json::Value| assert!(value.as_f64().unwrap() > 0.0, "{value}");
    for field in ["wall_s", "scans_per_s", "cpu_s", "submaps", "map_area_m2", "trajectory_length_m"] {
        positive(&report[field]);
    }
    for field in ["memory_bytes", "shared_memory_bytes", "file_bytes"] {
        positive(&report[field]);
    }
    positive(&report["supervisor"]["peak_private_bytes"]);
    for quantile in ["p50", "p99", "max"] {
        positive(&report["scan_to_pose_us"][quantile]);
    }
    assert_eq!(report["map_hash"].as_str().unwrap().len(), 64);
    assert_eq!(report["configuration"]["simulation"]["duration_s"], f64::from(DURATION_S));
    for closures in ["tried", "accepted", "revoked"] {
        assert!(report["loop_closures"][closures].is_u64());
    }
    assert_eq!(report["stages"].as_object().unwrap().len(), 6);
    for stage in support::stage_names() {
        let stage = &report["stages"][stage];
        assert_eq!((stage["pids"].as_array().unwrap().len(), stage["restarts"].as_u64()), (1, Some(0)));
        positive(&stage["cpu_s"]);
        positive(&stage["peak_rss_bytes"]);
        positive(&stage["peak_private_bytes"]);
        positive(&stage["latency_us"]["p50"]);
    }
}

#[test]
fn a_map_server_can_read_the_map() {
    let outputs = outputs();
    let yaml = outputs.lines("map.yaml");
    let value = |key: &str| {
        let line = yaml.iter().find_map(|line| line.strip_prefix(&format!("{key}: ")));
        line.unwrap_or_else(|| panic!("map.yaml has no {key}")).to_owned()
    };
    let cell_size_m: f64 = value("resolution").parse().unwrap();
    assert_eq!((value("mode").as_str(), value("negate").as_str()), ("trinary", "0"));
    let origin: Vec<f64> =
        value("origin").trim_matches(['[', ']']).split(", ").map(|n| n.parse().unwrap()).collect();
    let (occupied, free): (f64, f64) =
        (value("occupied_thresh").parse().unwrap(), value("free_thresh").parse().unwrap());
    let picture = image::open(outputs.directory.join(value("image"))).unwrap().into_luma8();
    let darkness = |pixel: u8| f64::from(255 - pixel) / 255.0;
    let cells_with =
        |is: &dyn Fn(f64) -> bool| picture.pixels().filter(|pixel| is(darkness(pixel.0[0]))).count();
    let (walls, space) = (cells_with(&|dark| dark > occupied), cells_with(&|dark| dark < free));
    let area_m2 = (walls + space) as f64 * cell_size_m * cell_size_m;
    assert!((area_m2 - outputs.report.map_area_m2).abs() < 1e-6 * area_m2, "{area_m2} m²");
    assert!(walls > 500 && space > 10 * walls, "{walls} cells of walls, {space} of free space");
    // The robot was where the map says that there is space.
    let (mut in_space, trajectory) = (0, outputs.trajectory("trajectory.tum"));
    for point in &trajectory {
        let column = (point.map_from_base.x_m - origin[0]) / cell_size_m;
        let row = f64::from(picture.height()) - (point.map_from_base.y_m - origin[1]) / cell_size_m;
        in_space += usize::from(darkness(picture.get_pixel(column as u32, row as u32).0[0]) < free);
    }
    assert!(
        in_space * 100 >= trajectory.len() * 99,
        "{in_space} of {} poses in free space",
        trajectory.len()
    );
    let people = image::open(outputs.directory.join("map.png")).unwrap();
    assert!(people.width() >= picture.width() / 2 && people.height() > 100);
}

#[test]
fn an_evaluation_against_the_truth_is_written_as_json() {
    let outputs = outputs();
    let directory = tempfile::tempdir().unwrap();
    let (at, json) = (|name: &str| outputs.directory.join(name), directory.path().join("figures.json"));
    let mut command = support::flockslam();
    command.arg("evaluate").arg("--trajectory").arg(at("trajectory.tum")).arg("--truth").arg(at("truth.tum"));
    let output = command.arg("--json").arg(&json).output().unwrap();
    assert!(output.status.success(), "{}", support::stderr(&output));
    let figures: serde_json::Value = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
    let rmse = figures["truth"]["absolute"]["translation_m"]["rmse"].as_f64().unwrap();
    assert!((rmse - truth_error_m(outputs)).abs() < 1e-9);
}
