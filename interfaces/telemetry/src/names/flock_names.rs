//! Metrics of a robot's flock.

use super::{
    Kind, LABEL_DIRECTION, LABEL_PEER, LABEL_REPLICA, LABEL_STAGE, Metric, STAGE_REASON, of_one_stage,
    with_labels,
};

/// Robots that are connected.
pub const FLOCK_PEERS: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_peers",
    Kind::Gauge,
    "Other robots of the flock that are connected just now",
);
/// Robots that are talked to.
pub const FLOCK_NEAR: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_near",
    Kind::Gauge,
    "Of the robots that are connected, those that are near: records are exchanged with them alone",
);
/// Robots in the common map.
pub const FLOCK_MEMBERS: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_members",
    Kind::Gauge,
    "Robots that are part of the common map, this one among them; 0 while it is not",
);
/// Size of the flock's map and records.
pub const FLOCK_RECORD_BYTES: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_record_bytes",
    Kind::Gauge,
    "Bytes of all records that the robot knows, its own among them",
);
/// Records that are known.
pub const FLOCK_RECORDS: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_records",
    Kind::Gauge,
    "Records that the robot knows, its own among them",
);
/// What ties robots together.
pub const FLOCK_CLOSURES: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_closures",
    Kind::Gauge,
    "Closures between robots that act in the common map",
);
/// What does not.
pub const FLOCK_CONFLICTS: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_conflicts",
    Kind::Gauge,
    "Closures between robots that do not act, since they are too few or contradict the others",
);
/// Searches between robots.
pub const FLOCK_SEARCHES: Metric = of_one_stage(
    "sync-manager",
    "flockslam_flock_searches_total",
    Kind::Counter,
    "Searches for own places in the maps of other robots",
);
/// Traffic, by `peer` and `direction`.
pub const FLOCK_PEER_BYTES: Metric = with_labels(
    of_one_stage(
        "sync-manager",
        "flockslam_flock_peer_bytes_total",
        Kind::Counter,
        "Bytes of messages that were `sent` to and `received` of another robot",
    ),
    &[LABEL_STAGE, LABEL_REPLICA, LABEL_PEER, LABEL_DIRECTION],
);
/// What was not taken from or sent to others, by `reason`.
pub const FLOCK_DROPPED: Metric = with_labels(
    of_one_stage(
        "sync-manager",
        "flockslam_flock_dropped_total",
        Kind::Counter,
        "Messages and records of other robots that were refused, and messages that were not sent",
    ),
    STAGE_REASON,
);
