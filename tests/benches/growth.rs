//! What grows with the way through ever new corridors: `cargo bench -p flockslam --bench growth -- [KM]`, 10 km by default. Drives of a
//! quarter, a half and the whole of it are simulated in one plan of 150 km of corridors, and mapped by a whole set that writes all outputs.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, unused_imports, reason = "a benchmark needs a part of what tests share")]
#[path = "../support/mod.rs"]
mod support;

use flockslam_evidence::CellState;
use flockslam_geometry::Point;
use flockslam_random::Random;
use support::plan_pictures::PlanPicture;
use support::run_well;
use support::seeded_drives::absolute_error_m;

/// Side of the plan, metres.
const SIDE_M: f64 = 960.0;
const CELL_M: f64 = 0.1;
/// Solid rim of the plan, metres.
const RIM_M: f64 = 2.0;
/// From one corridor to the next, metres.
const SPACING_M: (f64, f64) = (9.0, 15.0);
const WIDTH_M: (f64, f64) = (1.8, 2.8);
/// Niches tell corridors from one another: one on each side for about so much of the way, metres.
const NICHE_EVERY_M: (f64, f64) = (2.0, 7.0);
const NICHE_M: (f64, f64) = (0.4, 2.0);
const NICHE_DEPTH_M: (f64, f64) = (0.2, 1.2);
/// A robot drives about so many metres in a second of such a tour.
const DRIVEN_M_S: f64 = 0.77;

/// What a drive took.
struct Cost {
    area_m2: f64,
    /// The set without lidar-ingest, which holds the plan, bytes.
    memory_bytes: f64,
    /// Processor time for each scan without lidar-ingest, ms.
    cpu_ms: f64,
}

fn main() {
    // Cargo adds an option of its own.
    let given = std::env::args().skip(1).find(|argument| argument != "--bench");
    let km: f64 = given.map_or(10.0, |given| given.parse().expect("kilometres"));
    let directory = tempfile::tempdir().expect("a directory");
    let world = corridors().write(directory.path(), "corridors").display().to_string();
    let drives: Vec<Cost> = [0.25, 0.5, 1.0].iter().map(|share| drive(&world, share * km)).collect();
    let [first, .., last] = drives.as_slice() else { return };
    println!(
        "from the first to the last: {:.1} kB for each m² mapped, {:+.0} % of processor time for each scan",
        1e-3 * (last.memory_bytes - first.memory_bytes) / (last.area_m2 - first.area_m2),
        100.0 * (last.cpu_ms / first.cpu_ms - 1.0)
    );
}

/// Maps a drive of about so many kilometres, and prints what it took.
fn drive(world: &str, km: f64) -> Cost {
    let directory = tempfile::tempdir().expect("a directory");
    let seconds = (1e3 * km / DRIVEN_M_S).round();
    let args = ["demo", "--world", world, "--set", &format!("simulation.duration_s={seconds}")];
    let outputs = run_well("growth", &directory.path().join("out"), &args.map(str::to_owned));
    let report = &outputs.report;
    let ingest = &report.stages["lidar-ingest"];
    let cost = Cost {
        area_m2: report.map_area_m2,
        memory_bytes: (report.memory_bytes - ingest.peak_private_bytes) as f64,
        cpu_ms: 1e3 * (report.cpu_s - ingest.cpu_s) / report.scans as f64,
    };
    let of_sync_manager = &report.stages["sync-manager"];
    println!(
        "{:.2} km, {} scans, {:.0} m² mapped, ATE {:.3} m, {} closures, {} scans unattached: {:.1} MB (sync-manager {:.1} MB), {:.3} ms a scan \
         (sync-manager {:.3} ms), without lidar-ingest",
        1e-3 * report.trajectory_length_m,
        report.scans,
        cost.area_m2,
        absolute_error_m(&outputs, "trajectory.tum").rmse,
        report.loop_closures.accepted,
        report.detached_scans,
        1e-6 * cost.memory_bytes,
        1e-6 * of_sync_manager.peak_private_bytes as f64,
        cost.cpu_ms,
        1e3 * of_sync_manager.cpu_s / report.scans as f64
    );
    cost
}

/// Corridors along both axes, with niches.
fn corridors() -> PlanPicture {
    let side = cells(SIDE_M);
    let mut plan = PlanPicture {
        width: side,
        height: side,
        cell_size_m: CELL_M,
        origin: Point::new(0.0, 0.0),
        cells: vec![CellState::Occupied; side * side],
    };
    let mut random = Random::new(1, "corridors");
    for is_upright in [false, true] {
        let mut across_m = RIM_M + NICHE_DEPTH_M.1;
        while across_m + WIDTH_M.1 + NICHE_DEPTH_M.1 + RIM_M < SIDE_M {
            let width_m = random.between(WIDTH_M.0, WIDTH_M.1);
            clear(&mut plan, is_upright, (RIM_M, SIDE_M - RIM_M), (across_m, across_m + width_m));
            for wall_m in [across_m, across_m + width_m] {
                let outward = if wall_m > across_m { 1.0 } else { -1.0 };
                let mut along_m = RIM_M;
                while along_m < SIDE_M - RIM_M - NICHE_M.1 {
                    let (long_m, deep_m) = (
                        random.between(NICHE_M.0, NICHE_M.1),
                        random.between(NICHE_DEPTH_M.0, NICHE_DEPTH_M.1),
                    );
                    let end_m = wall_m + outward * deep_m;
                    let depth = (wall_m.min(end_m), wall_m.max(end_m));
                    clear(&mut plan, is_upright, (along_m, along_m + long_m), depth);
                    along_m += long_m + random.between(NICHE_EVERY_M.0, NICHE_EVERY_M.1);
                }
            }
            across_m += random.between(SPACING_M.0, SPACING_M.1);
        }
    }
    plan
}

/// Frees a rectangle, given along and across a corridor, metres.
fn clear(plan: &mut PlanPicture, is_upright: bool, along_m: (f64, f64), across_m: (f64, f64)) {
    let (x_m, y_m) = if is_upright { (across_m, along_m) } else { (along_m, across_m) };
    for y in cells(y_m.0)..cells(y_m.1) {
        plan.cells[y * plan.width + cells(x_m.0)..y * plan.width + cells(x_m.1)].fill(CellState::Free);
    }
}

fn cells(metres: f64) -> usize {
    (metres / CELL_M).round() as usize
}
