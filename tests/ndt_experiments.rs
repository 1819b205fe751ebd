//! The two experiments of the published NDT system (Trubin et al. 2020), with `--profile ndt`.

use crate::support;
use crate::support::ndt_system::{PLAIN, run_ndt};
use flockslam_drives::experiments::{BEARING_SIGMA_RAD, Experiment, flat, one_mover};
use flockslam_drives::ndt_system::{MoveError, errors};
use flockslam_geometry::{Point, Pose};

/// The largest errors of the twelve moves.
fn worst(flat: &Experiment) -> MoveError {
    let directory = tempfile::tempdir().unwrap();
    let outputs = run_ndt(flat, flat.scans.len(), directory.path(), &[]);
    let poses: Vec<Pose> =
        outputs.trajectory("trajectory.tum").iter().map(|point| point.map_from_base).collect();
    assert_eq!(poses.len(), flat.truth.len());
    let errors = errors(&poses, &flat.truth);
    for (i, MoveError { way_m, turn_deg, end_m }) in errors.iter().enumerate() {
        println!("scan {}: {:.1} mm, {turn_deg:.3}°, its end {:.1} mm", i + 2, 1e3 * way_m, 1e3 * end_m);
    }
    errors.into_iter().fold(MoveError::default(), MoveError::max)
}

#[test]
fn thirteen_scans_in_a_flat_are_matched_from_the_odometry_guess() {
    let worst = worst(&flat(0.0));
    assert!(worst.end_m < 0.010 && worst.turn_deg < 0.5, "{worst:?}");
}

/// Each beam for itself points elsewhere by a degree: at eight metres, walls of a corridor are a band 28 cm wide.
#[test]
fn beams_that_point_elsewhere_by_a_degree_do_not_lead_astray() {
    let worst = worst(&flat(BEARING_SIGMA_RAD));
    assert!(worst.way_m < 0.010 && worst.turn_deg < 0.5, "{worst:?}");
    // After moves of metres a heading that is off by a quarter of a degree counts for more than this.
    assert!(worst.end_m < 0.025, "{worst:?}");
}

/// Occupied cells where somebody was, but is not at the last of `count` scans.
fn trail(experiment: &Experiment, count: usize, more: &[&str]) -> usize {
    let directory = tempfile::tempdir().unwrap();
    let outputs = run_ndt(experiment, count, directory.path(), more);
    let (last, before) = experiment.movers[..count].split_last().unwrap();
    let near = |mover: &Point, cell: Point| mover.distance_m(cell) < 0.35;
    // The map begins where the robot does.
    let in_room = |cell: Point| experiment.truth[0].apply(cell);
    support::occupied_cells(&outputs)
        .map(in_room)
        .filter(|cell| before.iter().any(|mover| near(mover, *cell)) && !near(last, *cell))
        .count()
}

#[test]
fn a_mover_in_a_room_leaves_a_trail_only_without_the_update() {
    let room = one_mover();
    let far = [trail(&room, 3, &[PLAIN]), trail(&room, 3, &[])];
    let [plain, modified] = [trail(&room, 8, &[PLAIN]), trail(&room, 8, &[])];
    println!(
        "cells of the trail seen from far away: {far:?}; at the end {plain} without the update, {modified} with it"
    );
    assert!(far[1] > 5, "what lies beyond the effective radius waits until the robot comes near: {far:?}");
    assert!(plain > 40 && modified * 20 <= plain, "{plain} {modified}");
}
