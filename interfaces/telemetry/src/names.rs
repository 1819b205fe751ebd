//! Every metric of the system: name, kind, help text, labels, buckets. Names follow the Prometheus conventions (base units,
//! one prefix); dashboards and rules refer to these names and no others, and `docs/metrics.md` is made from this file.

mod flock_names;

pub use flock_names::{
    FLOCK_CLOSURES, FLOCK_CONFLICTS, FLOCK_DROPPED, FLOCK_MEMBERS, FLOCK_NEAR, FLOCK_PEER_BYTES, FLOCK_PEERS,
    FLOCK_RECORD_BYTES, FLOCK_RECORDS, FLOCK_SEARCHES,
};

/// What all names begin with.
pub const PREFIX: &str = "flockslam_";

/// Label: the stage that speaks, for example `scan-matcher`.
pub const LABEL_STAGE: &str = "stage";
/// Label: which replica of the stage, from 0.
pub const LABEL_REPLICA: &str = "replica";
/// Label: why something happened.
pub const LABEL_REASON: &str = "reason";
/// Label: another robot of the flock: its name and the first digits of its key, or `others` beyond 32 of them.
pub const LABEL_PEER: &str = "peer";
/// Label: `sent` (to another robot) or `received` (from it).
pub const LABEL_DIRECTION: &str = "direction";
/// Label: one of the robot's lidars, by its name: that of its driver, the topic of a recording, else `0`.
pub const LABEL_LIDAR: &str = "lidar";
/// Label: how far a pose can be trusted: `tracking`, `degraded` or `lost`.
pub const LABEL_QUALITY: &str = "quality";

pub use crate::names_of_lidars::*;

/// What kind of metric it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Only grows, also across restarts of the stage.
    Counter,
    /// Goes up and down.
    Gauge,
    /// Counts of values, in buckets with these upper bounds.
    Histogram(&'static [f64]),
}

impl Kind {
    /// The name that Prometheus has for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Histogram(_) => "histogram",
        }
    }
}

/// A metric: its name, its kind and its labels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// Full name.
    pub name: &'static str,
    /// Counter, gauge or histogram.
    pub kind: Kind,
    /// Names of its labels.
    pub labels: &'static [&'static str],
    /// Its source: a stage, `each stage`, or `supervisor`.
    pub source: &'static str,
    /// One line for people.
    pub help: &'static str,
}

const STAGE: &[&str] = &[LABEL_STAGE, LABEL_REPLICA];
const STAGE_REASON: &[&str] = &[LABEL_STAGE, LABEL_REPLICA, LABEL_REASON];
const EACH_STAGE: &str = "each stage";
const SUPERVISOR: &str = "supervisor";

/// Upper bounds of the latency buckets, seconds: 10 µs … 1 s in steps of 2 to 2.5.
pub const LATENCY_BUCKETS_S: [f64; 16] = [
    10e-6, 20e-6, 50e-6, 100e-6, 200e-6, 500e-6, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 100e-3, 200e-3,
    500e-3, 1.0,
];
const SCORE_BUCKETS: [f64; 10] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
/// Metres or radians: 1 mm … 10 m.
const SPREAD_BUCKETS: [f64; 13] = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];
const SOLVING_BUCKETS_S: [f64; 12] = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0];

const fn of_stage(name: &'static str, kind: Kind, help: &'static str) -> Metric {
    Metric { name, kind, labels: STAGE, source: EACH_STAGE, help }
}

pub(crate) const fn of_one_stage(
    source: &'static str,
    name: &'static str,
    kind: Kind,
    help: &'static str,
) -> Metric {
    Metric { name, kind, labels: STAGE, source, help }
}

const fn of_supervisor(
    name: &'static str,
    kind: Kind,
    labels: &'static [&'static str],
    help: &'static str,
) -> Metric {
    Metric { name, kind, labels, source: SUPERVISOR, help }
}

pub(crate) const fn with_labels(metric: Metric, labels: &'static [&'static str]) -> Metric {
    Metric { labels, ..metric }
}

/// Seconds in one stage's `handle` per scan.
pub const STAGE_LATENCY: Metric = of_stage(
    "flockslam_stage_latency_seconds",
    Kind::Histogram(&LATENCY_BUCKETS_S),
    "Time that the stage's own logic took for one scan",
);
/// Seconds from the capture of a scan to the stage's output for it.
pub const SCAN_TO_OUTPUT: Metric = of_stage(
    "flockslam_scan_to_output_seconds",
    Kind::Histogram(&LATENCY_BUCKETS_S),
    "Time from the capture of a scan to the output of the stage for it; of scan-matcher, to the published pose",
);
/// Scans that the stage has handled.
pub const SCANS_HANDLED: Metric = of_stage(
    "flockslam_scans_handled_total",
    Kind::Counter,
    "Scans that the stage has handled; its rate is the input rate",
);
/// Scans or messages that the stage has dropped, by `reason`.
pub const DROPPED: Metric = with_labels(
    of_stage("flockslam_dropped_total", Kind::Counter, "Scans or messages that the stage has dropped"),
    STAGE_REASON,
);
/// Sequence number of the last handled scan.
pub const LAST_SCAN_SEQUENCE: Metric = of_stage(
    "flockslam_last_scan_sequence",
    Kind::Gauge,
    "Sequence number of the last scan that the stage has handled",
);
/// Seconds since the capture of the last handled scan.
pub const LAST_SCAN_AGE: Metric = of_stage(
    "flockslam_last_scan_age_seconds",
    Kind::Gauge,
    "Time since the capture of the last scan that the stage has handled; before the first, since its start",
);
/// Scans that wait in the stage for something else.
pub const WAITING_SCANS: Metric = of_stage(
    "flockslam_waiting_scans",
    Kind::Gauge,
    "Scans that the stage holds and has not handled yet: the depth of its queue",
);
/// CLOCK_MONOTONIC seconds of the last sign of life.
pub const HEARTBEAT: Metric = of_stage(
    "flockslam_heartbeat_monotonic_seconds",
    Kind::Gauge,
    "Monotonic clock at the last sign of life of the stage",
);
/// Processor time of the process.
pub const CPU: Metric = of_stage(
    "flockslam_stage_cpu_seconds_total",
    Kind::Counter,
    "Processor time of all threads; of the supervisor too, as stage=\"supervisor\"",
);
/// Private memory of the process.
pub const PRIVATE_MEMORY: Metric = of_stage(
    "flockslam_stage_private_memory_bytes",
    Kind::Gauge,
    "Memory of the process's own, not what is shared; of the supervisor too, as stage=\"supervisor\"",
);
/// Process id.
pub const PROCESS_ID: Metric = of_stage(
    "flockslam_stage_process_id",
    Kind::Gauge,
    "Process id: another number is another process of the stage",
);

/// Scans that the filter let pass, by `reason`.
pub const KEPT: Metric = with_labels(
    of_one_stage(
        "correlation-filter",
        "flockslam_kept_total",
        Kind::Counter,
        "Scans that the filter let pass",
    ),
    STAGE_REASON,
);

/// Poses by quality.
pub const POSES: Metric = with_labels(
    of_one_stage(
        "scan-matcher",
        "flockslam_poses_total",
        Kind::Counter,
        "Poses by how far they can be trusted: degraded along a bare wall or after a bad fit, lost where the scan does not fit",
    ),
    &[LABEL_STAGE, LABEL_REPLICA, LABEL_QUALITY],
);
/// How well matched scans fit.
pub const MATCH_SCORE: Metric = of_one_stage(
    "scan-matcher",
    "flockslam_match_score",
    Kind::Histogram(&SCORE_BUCKETS),
    "How well matched scans fit the grid, 0 to 1",
);
/// Uncertainty of the position.
pub const POSITION_STD: Metric = of_one_stage(
    "scan-matcher",
    "flockslam_pose_position_std_meters",
    Kind::Histogram(&SPREAD_BUCKETS),
    "Standard deviation of matched positions along the direction that is known worst",
);
/// Uncertainty of the heading.
pub const HEADING_STD: Metric = of_one_stage(
    "scan-matcher",
    "flockslam_pose_heading_std_radians",
    Kind::Histogram(&SPREAD_BUCKETS),
    "Standard deviation of the heading of matched scans",
);
/// Wide searches after a bad fit.
pub const RESCUE_SEARCHES: Metric = of_one_stage(
    "scan-matcher",
    "flockslam_rescue_searches_total",
    Kind::Counter,
    "Scans whose pose took a wide search",
);
/// Verdicts that the matcher overruled.
pub const OVERRULED: Metric = of_one_stage(
    "scan-matcher",
    "flockslam_overruled_verdicts_total",
    Kind::Counter,
    "Scans that were matched although the filter wanted to drop them",
);
/// Accepted scans.
pub const SCANS_ACCEPTED: Metric = of_one_stage(
    "scan-matcher",
    "flockslam_scans_accepted_total",
    Kind::Counter,
    "Scans whose evidence enters the map",
);

/// Cells of moving or removed things.
pub const CLEARED_CELLS: Metric = of_one_stage(
    "dynamic-cleaner",
    "flockslam_cleared_cells_total",
    Kind::Counter,
    "Cells whose evidence for occupied was found stale and cleared",
);
/// Beams on moving things.
pub const MOVING_BEAMS: Metric = of_one_stage(
    "dynamic-cleaner",
    "flockslam_moving_beams_total",
    Kind::Counter,
    "Beams judged to lie on moving objects",
);

/// Closed submaps.
pub const SUBMAPS: Metric = of_one_stage("mapper", "flockslam_submaps", Kind::Gauge, "Closed submaps");
/// Tiles of the window.
pub const LIVE_TILES: Metric = of_one_stage(
    "mapper",
    "flockslam_live_tiles",
    Kind::Gauge,
    "Tiles of the grid that scans are matched to just now",
);

/// Searches for loops.
pub const CLOSURE_SEARCHES: Metric = of_one_stage(
    "sync-manager",
    "flockslam_closure_searches_total",
    Kind::Counter,
    "Loop closures tried: searches for a scan's place in a segment",
);
/// Loops that were found and accepted.
pub const CLOSURES_ACCEPTED: Metric = of_one_stage(
    "sync-manager",
    "flockslam_closures_accepted_total",
    Kind::Counter,
    "Loop closures accepted: those that passed all checks of their own",
);
/// Loops that do not act.
pub const CLOSURES_REVOKED: Metric = of_one_stage(
    "sync-manager",
    "flockslam_closures_revoked",
    Kind::Gauge,
    "Accepted loop closures that do not act just now, since they contradict the others",
);
/// Time for a conclusion.
pub const OPTIMISATION: Metric = of_one_stage(
    "sync-manager",
    "flockslam_optimisation_seconds",
    Kind::Histogram(&SOLVING_BUCKETS_S),
    "Time for the loop searches and the solution of the pose graph after a closed submap",
);
/// Size of the map.
pub const MAP_AREA: Metric = of_one_stage(
    "sync-manager",
    "flockslam_map_area_square_meters",
    Kind::Gauge,
    "Area of the fused map that something is known of, in blocks of 8 by 8 cells",
);
/// Scans of detached trajectories.
pub const UNATTACHED_SCANS: Metric = of_one_stage(
    "sync-manager",
    "flockslam_unattached_scans",
    Kind::Gauge,
    "Scans of trajectories that nothing connects with the map",
);
/// Their way.
pub const UNATTACHED_TRAVEL: Metric = of_one_stage(
    "sync-manager",
    "flockslam_unattached_meters",
    Kind::Gauge,
    "Way driven in trajectories that nothing connects with the map",
);

/// Restarts, by `stage` and `reason`.
pub const STAGE_RESTARTS: Metric = of_supervisor(
    "flockslam_stage_restarts_total",
    Kind::Counter,
    &[LABEL_STAGE, LABEL_REASON],
    "Restarts of the stage by the supervisor: because it died, because it hung, or by order",
);
/// 1 when the stage's metrics could be read, by `stage`.
pub const STAGE_UP: Metric = of_supervisor(
    "flockslam_stage_up",
    Kind::Gauge,
    &[LABEL_STAGE],
    "1 when the stage runs and answers, 0 otherwise",
);
/// Seconds since a process gave a sign of life, seen from outside.
pub const HEARTBEAT_AGE: Metric = of_supervisor(
    "flockslam_heartbeat_age_seconds",
    Kind::Gauge,
    STAGE,
    "Time since the last sign of life of the process; the supervisor reports it, also when the process cannot",
);
/// Bytes of shared memory held by the process set.
pub const SHARED_MEMORY: Metric = of_supervisor(
    "flockslam_shared_memory_bytes",
    Kind::Gauge,
    &[],
    "Shared memory of the whole process set",
);
/// Stages that were replaced because they gave no sign of life, by `stage`.
pub const STAGE_HANGS: Metric = of_supervisor(
    "flockslam_stage_hangs_total",
    Kind::Counter,
    &[LABEL_STAGE],
    "Replacements of the stage because it hung",
);
/// 1 when the stage does not get up and the set goes on without it, by `stage`.
pub const STAGE_DEGRADED: Metric = of_supervisor(
    "flockslam_stage_degraded",
    Kind::Gauge,
    &[LABEL_STAGE],
    "1 when the stage does not get up and the set goes on without it",
);
/// 1 when the map cannot be saved to disk.
pub const NOT_DURABLE: Metric =
    of_supervisor("flockslam_not_durable", Kind::Gauge, &[], "1 when the map cannot be saved to disk");

/// All metrics, by source.
pub const ALL: [Metric; 53] = [
    STAGE_LATENCY,
    SCAN_TO_OUTPUT,
    SCANS_HANDLED,
    DROPPED,
    LAST_SCAN_SEQUENCE,
    LAST_SCAN_AGE,
    WAITING_SCANS,
    HEARTBEAT,
    CPU,
    PRIVATE_MEMORY,
    PROCESS_ID,
    LIDAR_SCANS,
    LIDAR_AGE,
    LIDAR_LOST,
    LIDAR_RETURNS,
    LIDAR_STATE,
    LIDAR_SPEED,
    KEPT,
    POSES,
    MATCH_SCORE,
    POSITION_STD,
    HEADING_STD,
    RESCUE_SEARCHES,
    OVERRULED,
    SCANS_ACCEPTED,
    CLEARED_CELLS,
    MOVING_BEAMS,
    SUBMAPS,
    LIVE_TILES,
    CLOSURE_SEARCHES,
    CLOSURES_ACCEPTED,
    CLOSURES_REVOKED,
    UNATTACHED_SCANS,
    UNATTACHED_TRAVEL,
    OPTIMISATION,
    MAP_AREA,
    FLOCK_PEERS,
    FLOCK_MEMBERS,
    FLOCK_NEAR,
    FLOCK_RECORDS,
    FLOCK_RECORD_BYTES,
    FLOCK_CLOSURES,
    FLOCK_CONFLICTS,
    FLOCK_SEARCHES,
    FLOCK_PEER_BYTES,
    FLOCK_DROPPED,
    STAGE_RESTARTS,
    STAGE_UP,
    HEARTBEAT_AGE,
    STAGE_HANGS,
    STAGE_DEGRADED,
    NOT_DURABLE,
    SHARED_MEMORY,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_prefixed_and_in_base_units() {
        for metric in ALL {
            assert!(metric.name.starts_with(PREFIX) && !metric.help.is_empty());
            assert!(metric.name.bytes().all(|b| b.is_ascii_lowercase() || b == b'_'), "{}", metric.name);
            assert!(!metric.name.contains("micro") && !metric.name.contains("milli"));
            let other_units =
                ["ms", "us", "ns", "minutes", "hours", "degrees", "percent", "kilobytes", "megabytes"];
            assert!(metric.name.split('_').all(|word| !other_units.contains(&word)), "{}", metric.name);
            assert_eq!(ALL.iter().filter(|other| other.name == metric.name).count(), 1);
            assert_eq!(metric.name.ends_with("_total"), metric.kind == Kind::Counter, "{}", metric.name);
            if let Kind::Histogram(bounds) = metric.kind {
                assert!(
                    !bounds.is_empty() && bounds.windows(2).all(|pair| pair[0] < pair[1]),
                    "{}",
                    metric.name
                );
            }
        }
    }
}
