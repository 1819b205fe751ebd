//! The poses that a robot drives by on the three benchmark logs: how far off they are, and what a correction makes of them.

use crate::support::public_logs::{ACES, FILTER_OFF, FR079, INTEL, Log, assert_no_worse};

/// What the published poses of each log reach, without the filter: mean errors over all relations and over loops, metres.
const REACHED: [(Log, f64, f64); 3] =
    [(INTEL, 0.0257, 0.0431), (FR079, 0.0341, 0.0506), (ACES, 0.0782, 0.627)];
/// What they reach with default settings: mean errors over all relations, metres and degrees.
const REACHED_BY_DEFAULT: [(Log, f64, f64); 3] =
    [(INTEL, 0.0426, 0.365), (FR079, 0.0351, 0.653), (ACES, 0.0914, 0.593)];

#[test]
fn published_poses_of_each_log_are_as_accurate_as_before() {
    for (log, reached_m, reached_loop_m) in REACHED {
        let Some(run) = log.shared_run(&["--set", FILTER_OFF]) else { return };
        let errors = log.errors_online(run.wait());
        assert_no_worse(&log, &errors, &[(errors.mean_m, reached_m), (errors.loop_m, reached_loop_m)]);
    }
}

#[test]
fn published_poses_of_each_log_are_as_accurate_with_default_settings() {
    for (log, reached_m, reached_deg) in REACHED_BY_DEFAULT {
        let Some(run) = log.shared_run(&[]) else { return };
        let errors = log.errors_online(run.wait());
        assert_no_worse(&log, &errors, &[(errors.mean_m, reached_m), (errors.mean_deg, reached_deg)]);
    }
}
