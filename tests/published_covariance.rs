//! Whether the covariance that is published beside a pose says how wrong the pose is: the normalised estimation error
//! squared (NEES: Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2) over 50 independent simulated drives.
//!
//! The covariance is that of the pose *against the grid that was matched*, so the grid must be right for the error to be
//! the matcher's own: scans enter the map where the robot truly was. In a map of its own poses the robot would be measured
//! against the errors of its past as well, which no matcher can know. All else is as in a run: wheels that slip, beams
//! taken while driving, a fit against the window of the last submaps.

use flockslam_drives::nees::nees_of_run;

/// The mean over 50 drives: of so many single values with three degrees of freedom it would lie within these bounds with a
/// probability of 95 %; each value is itself the mean over a drive, which is steadier.
const RUNS: u64 = 50;
const MEAN_NEES: std::ops::RangeInclusive<f64> = 2.36..=3.72;

#[test]
fn pose_errors_match_their_covariance() {
    let all: Vec<f64> = (0..RUNS).map(nees_of_run).collect();
    let mean = all.iter().sum::<f64>() / RUNS as f64;
    let mut sorted = all.clone();
    sorted.sort_by(f64::total_cmp);
    println!("NEES of {RUNS} runs: mean {mean:.2}, median {:.2}, greatest {:.1}", sorted[25], sorted[49]);
    assert!(MEAN_NEES.contains(&mean), "mean NEES {mean}");
}
