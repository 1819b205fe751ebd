//! Worlds in which many a system fails, simulated with their exact truth: buildings whose corridors all look alike, a
//! kilometre driven in each, and a way outdoors on which most beams return nothing.

use crate::support;
use crate::support::public_logs::FILTER_OFF;
use crate::support::seeded_drives::{YardDrive, absolute_error_m};
use crate::support::{Outputs, building};
use flockslam::evaluation::Spread;

/// Mean error of the final trajectory in a building, metres.
const MEAN_ERROR_M: f64 = 0.05;
/// A false closure that acts leaves an error of at least half the smallest repetition in a building (0.87 m), metres.
const TORN_M: f64 = 0.4;
/// So many of a thousand seconds said to be tracked may be wrong, over so many seeds.
const FALSE_CLAIMS_PER_MILLE: usize = 1;
const YARD_SEEDS: u64 = 4;
/// Error of the final trajectories in the yard, root mean square, in the mean of these seeds, metres: a tenth more than 0.236 m.
const YARD_ERROR_M: f64 = 0.26;
/// Error of the final trajectory where a robot turns among plants, root mean square, metres: a tenth more than 0.116 m.
const TURN_ERROR_M: f64 = 0.128;
/// Error of the final trajectory on a third of a tour of the campus, root mean square, metres: a tenth more than 0.29 m.
const CAMPUS_ERROR_M: f64 = 0.32;

/// The same over a quarter of an hour in which wheels slip three times, mean over these seeds, metres: a tenth more than 0.079 m.
const CAMPUS_SLIP_SEEDS: [u64; 3] = [3, 4, 5];
const CAMPUS_SLIP_ERROR_M: f64 = 0.087;

/// Error of the final trajectory in a warehouse without odometry, mean over the ways of five minutes of these seeds, metres: a tenth more than
/// 0.0183 m. While fits alone gave the velocity, it was 0.39 m: aisles came out shorter than they are.
const NO_ODOMETRY_SEEDS: [u64; 2] = [4, 5];
const NO_ODOMETRY_ERROR_M: f64 = 0.0201;

/// The same with odometry and wheels that slip twenty times, each time for a second: a tenth more than 0.0166 m. Poses of the last seed were
/// off by up to 0.42 m while a scan along racks counted as if odometry held it too.
const SLIP_SEEDS: [u64; 2] = [5, 7];
const SLIP_ERROR_M: f64 = 0.0183;

/// Error of the final trajectory in an office whose odometry has 2 cm and 1° of noise from scan to scan, mean over these seeds, metres: a tenth
/// more than 0.00265 m. While each scan was straightened by that odometry, it was 0.0043 m.
const NOISE_SEEDS: [u64; 2] = [2, 4];
const NOISE_ERROR_M: f64 = 0.0029;

fn world(name: &str, duration_s: u32) -> Vec<String> {
    let mut args = building(duration_s);
    args.extend(["--set".to_owned(), format!("simulation.world={name}")]);
    args
}

/// A kilometre through a building without a false closure.
fn drive_through_a_building(name: &str, duration_s: u32) {
    let directory = tempfile::tempdir().unwrap();
    let outputs = support::run_well(name, directory.path(), &world(name, duration_s));
    let driven_m = length_m(&outputs);
    let error = absolute_error_m(&outputs, "trajectory.tum");
    println!(
        "{name}: {driven_m:.0} m driven, {:?}, error of the final trajectory: mean {:.4} m, greatest {:.3} m; online: mean {:.4} m",
        outputs.report.loop_closures,
        error.mean,
        error.max,
        absolute_error_m(&outputs, "trajectory_online.tum").mean
    );
    assert!(driven_m > 1000.0, "only {driven_m} m");
    assert!(outputs.report.loop_closures.accepted > 0);
    assert!(error.max < TORN_M, "{name} is torn: {} m", error.max);
    assert!(error.mean < MEAN_ERROR_M, "{} m", error.mean);
}

#[test]
fn a_hotel_whose_corridors_are_all_alike() {
    drive_through_a_building("hotel", 1290);
}

#[test]
fn a_warehouse_whose_aisles_are_all_alike() {
    drive_through_a_building("warehouse", 1290);
}

/// On the second way along an aisle scans of one bay fit the next one, 0.96 m farther on, as well as the true one. One such match that was
/// taken for a loop drew the next after it: published poses were off by up to 3.3 m.
#[test]
fn an_aisle_whose_next_bay_fits_as_well_as_the_true_one() {
    let directory = tempfile::tempdir().unwrap();
    let mut args = world("warehouse", 620);
    args.extend(
        ["seed", "world_seed"]
            .into_iter()
            .flat_map(|key| ["--set".to_owned(), format!("simulation.{key}=5")]),
    );
    args.extend(["--set", FILTER_OFF].map(str::to_owned));
    let outputs = support::run_well("aisle", directory.path(), &args);
    for trajectory in ["trajectory_online.tum", "trajectory.tum"] {
        let error = absolute_error_m(&outputs, trajectory);
        println!("{trajectory}: mean {:.4} m, greatest {:.3} m", error.mean, error.max);
        assert!(error.max < TORN_M, "{trajectory} is torn: {} m", error.max);
    }
}

/// Mean error of the final poses in a warehouse, over seeds of 300 s each, metres.
fn warehouse_error_m(name: &str, seeds: &[u64], settings: &[&str]) -> f64 {
    let error_m = |seed: &u64| {
        let directory = tempfile::tempdir().unwrap();
        let mut args = world("warehouse", 300);
        let own = [format!("simulation.seed={seed}"), format!("simulation.world_seed={seed}")];
        let common = settings.iter().copied().chain([FILTER_OFF]).map(str::to_owned);
        args.extend(own.into_iter().chain(common).flat_map(|setting| ["--set".to_owned(), setting]));
        let outputs = support::run_well(name, directory.path(), &args);
        let error = absolute_error_m(&outputs, "trajectory.tum");
        println!("seed {seed}: mean {:.4} m, greatest {:.3} m", error.mean, error.max);
        error.mean
    };
    seeds.iter().map(error_m).sum::<f64>() / seeds.len() as f64
}

#[test]
fn aisles_do_not_come_out_shorter_without_odometry() {
    let mean_m = warehouse_error_m("no-odometry", &NO_ODOMETRY_SEEDS, &["lidar_ingest.odometry=false"]);
    assert!(mean_m <= NO_ODOMETRY_ERROR_M, "{mean_m} m");
}

/// While wheels slip, surfaces and the velocity before say how far a robot has gone between racks.
#[test]
fn aisles_do_not_come_out_shorter_where_wheels_slip() {
    let mean_m = warehouse_error_m("slips", &SLIP_SEEDS, &["simulation.wheel_slips=20"]);
    assert!(mean_m <= SLIP_ERROR_M, "{mean_m} m");
}

/// Where odometry has noise, the velocity before says better how fast a robot goes during a scan.
#[test]
fn noise_of_odometry_from_scan_to_scan_moves_poses_by_little() {
    let error_m = |seed: u64| {
        let directory = tempfile::tempdir().unwrap();
        let own = format!("simulation.seed={seed}");
        let settings = [FILTER_OFF, "lidar_ingest.odometry_noise=[0.02, 1.0]", &own];
        let set = settings.into_iter().flat_map(|setting| ["--set", setting]).map(str::to_owned);
        let args: Vec<String> = building(250).into_iter().chain(set).collect();
        absolute_error_m(&support::run_well("noise", directory.path(), &args), "trajectory.tum").mean
    };
    let errors = NOISE_SEEDS.map(error_m);
    println!("{errors:.5?} m");
    let mean_m = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean_m <= NOISE_ERROR_M, "{errors:?}");
}

/// Outdoors a pose is right or says that it may not be.
///
/// Wheels slip four times in each drive, by up to 60°, where a tree or two are in sight. Before scans showed it, the final trajectories were
/// off by 3.9 m in the mean of twenty seeds.
#[test]
fn of_a_thousand_seconds_in_a_yard_said_to_be_tracked_few_are_wrong() {
    let drives: Vec<YardDrive> = (1..=YARD_SEEDS).map(YardDrive::with_seed).collect();
    drives.iter().for_each(|drive| println!("{drive:?}"));
    let sum = |value: fn(&YardDrive) -> usize| drives.iter().map(value).sum::<usize>();
    let (wrong, claims) = (sum(|drive| drive.false_claims), sum(|drive| drive.claims));
    assert!(1000 * wrong <= FALSE_CLAIMS_PER_MILLE * claims, "{wrong} of {claims}: {drives:?}");
    let error_m = drives.iter().map(|drive| drive.ate_m).sum::<f64>() / drives.len() as f64;
    assert!(error_m < YARD_ERROR_M, "{error_m} m: {drives:?}");
    // Nor does it always report lost: 0.50 to 0.59 of the scans by seed.
    assert!(drives.iter().all(|drive| drive.tracked > 0.45), "{drives:?}");
}

/// A drive over a campus with a scan of 180 beams a second: its outputs and the error of its final trajectory.
fn on_a_campus(duration_s: u32, more: &[&str]) -> (Outputs, Spread) {
    let directory = tempfile::tempdir().unwrap();
    let mut args = world("campus", duration_s);
    let keys = ["wheel_slips=0", "scan_rate_hz=1", "beams=180", "field_of_view_deg=180", "range_max_m=80"];
    for key in keys.iter().chain(more) {
        args.extend(["--set".to_owned(), format!("simulation.{key}")]);
    }
    let outputs = support::run_well("campus", directory.path(), &args);
    let error = absolute_error_m(&outputs, "trajectory.tum");
    (outputs, error)
}

/// Among plants a fifth of a scan lies on something at many headings: 14.8 m where that counted as a sign of wheels that slip.
#[test]
fn a_robot_that_turns_among_plants_keeps_its_heading() {
    let (_outputs, error) = on_a_campus(400, &["world_seed=26", "seed=26", "lead_s=600"]);
    println!("campus 26: ATE {:.3} m", error.rmse);
    assert!(error.rmse < TURN_ERROR_M, "{} m", error.rmse);
}

/// Wheels that show turns of up to 46° a second which the robot does not make: 9.5 m where only surfaces that repeat showed it.
#[test]
fn on_a_campus_wheels_that_slip_do_not_turn_the_robot() {
    let error_m = |seed: u64| {
        let (world, drive) = (format!("world_seed={seed}"), format!("seed={seed}"));
        on_a_campus(900, &[&world, &drive, "wheel_slips=3"]).1.rmse
    };
    let errors_m = CAMPUS_SLIP_SEEDS.map(error_m);
    let mean_m = errors_m.iter().sum::<f64>() / errors_m.len() as f64;
    assert!(mean_m < CAMPUS_SLIP_ERROR_M, "{errors_m:?} m");
}

/// Half an hour on a campus with a scan of 180 beams a second: 0.5 km among lawns, hedges and slopes, with one loop.
#[test]
fn on_a_campus_every_scan_is_in_one_map() {
    let (outputs, error) = on_a_campus(1800, &[]);
    println!("campus: {:?}, ATE {:.3} m", outputs.report.loop_closures, error.rmse);
    assert_eq!((outputs.report.detached_scans, outputs.report.trajectories), (0, 1));
    assert!(outputs.report.loop_closures.accepted >= 5, "{:?}", outputs.report.loop_closures);
    assert!(error.rmse < CAMPUS_ERROR_M, "{} m", error.rmse);
}

fn length_m(outputs: &Outputs) -> f64 {
    let truth = outputs.trajectory("truth.tum");
    truth.windows(2).map(|pair| pair[0].map_from_base.distance_m(pair[1].map_from_base)).sum()
}
