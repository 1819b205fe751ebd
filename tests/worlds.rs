//! Worlds in which many a system fails, simulated with their exact truth: buildings whose corridors all look alike, a
//! kilometre driven in each, and a way outdoors on which most beams return nothing.

use crate::support;
use crate::support::{Outputs, RunningSet, building};
use flockslam::evaluation::{Spread, evaluate_truth};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, Quality};
use flockslam_stage::JournalReader;
use std::path::Path;
use std::time::Duration;

/// Mean error of the final trajectory in a building, metres.
const MEAN_ERROR_M: f64 = 0.05;
/// A false closure that acts leaves an error of at least half the smallest repetition in a building (0.87 m), metres.
const TORN_M: f64 = 0.4;
/// A motion over one second that is further off than this is wrong: metres and radians.
const WRONG: (f64, f64) = (0.15, 0.05);
/// So many of a thousand seconds said to be tracked may be wrong.
const FALSE_CLAIMS_PER_MILLE: usize = 2;
/// Scans in a second.
const SECOND: usize = 10;

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

/// Outdoors a pose is right or says that it may not be.
#[test]
fn a_yard_where_most_beams_return_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let (outputs, poses) = run_watched("yard", directory.path(), &world("yard", 520));
    let truth: Vec<Pose> = outputs.trajectory("truth.tum").iter().map(|point| point.map_from_base).collect();
    assert_eq!(poses.len(), truth.len(), "a pose for each scan");
    let tracked: Vec<bool> = poses.iter().map(|pose| pose.quality == Quality::Tracking as u32).collect();
    let wrong: Vec<usize> = (0..truth.len() - SECOND)
        .filter(|from| is_wrong(truth[*from].to(truth[from + SECOND]), &poses[*from..=from + SECOND]))
        .collect();
    // Who predicts a pose claims no fit.
    let matched = |k: usize| poses[k].has(PoseFlags::MATCHED);
    let claimed = |from: usize| {
        let to = from + SECOND;
        matched(from) && matched(to) && tracked[from..=to].iter().all(|tracked| *tracked)
    };
    let claims = (0..truth.len() - SECOND).filter(|from| claimed(*from)).count();
    let false_claims: Vec<_> = wrong.iter().filter(|from| claimed(**from)).collect();
    let share = tracked.iter().filter(|tracked| **tracked).count() as f64 / truth.len() as f64;
    println!(
        "yard: {:.0} m driven, {:.1} % tracked, {} seconds wrong, {} of them among the {claims} said to be tracked; final trajectory: {:?} m",
        length_m(&outputs),
        100.0 * share,
        wrong.len(),
        false_claims.len(),
        absolute_error_m(&outputs, "trajectory.tum")
    );
    let few = 1000 * false_claims.len() < FALSE_CLAIMS_PER_MILLE * claims;
    assert!(few, "wrong without saying so from scans {false_claims:?} on");
    // Nor does it never trust itself.
    assert!(share > 0.5);
}

/// Whether the motion over a second is not the true one.
fn is_wrong(truth: Pose, second: &[PoseEstimate]) -> bool {
    let estimated = second[0].odom_from_base.to(second[SECOND].odom_from_base);
    truth.distance_m(estimated) > WRONG.0 || truth.turn_rad(estimated) > WRONG.1
}

fn length_m(outputs: &Outputs) -> f64 {
    let truth = outputs.trajectory("truth.tum");
    truth.windows(2).map(|pair| pair[0].map_from_base.distance_m(pair[1].map_from_base)).sum()
}

fn absolute_error_m(outputs: &Outputs, name: &str) -> Spread {
    let report = evaluate_truth(&outputs.trajectory(name), &outputs.trajectory("truth.tum")).unwrap();
    report.absolute.translation_m.unwrap()
}

/// Runs a set and reads beside it, from the journal, every pose that it publishes.
fn run_watched(test: &str, out: &Path, args: &[String]) -> (Outputs, Vec<PoseEstimate>) {
    let set = RunningSet::start(test, out, args);
    let journal_dir = set.status_dir().with_file_name("journal");
    let running = std::thread::spawn(|| set.finish());
    let (mut journal, mut poses) = (None, Vec::new());
    loop {
        // Asked before reading: what is written before the end is then read after it.
        let ended = running.is_finished();
        if journal.is_none() && journal_dir.join("scans.journal").metadata().is_ok_and(|file| file.len() > 0)
        {
            journal = Some(JournalReader::open(&journal_dir).unwrap());
        }
        while let Some(record) = journal.as_mut().and_then(|journal| journal.read_next().unwrap()) {
            poses.push(record.pose);
        }
        if ended {
            return (running.join().unwrap(), poses);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}
