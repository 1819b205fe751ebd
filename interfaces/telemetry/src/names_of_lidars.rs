//! The metrics of lidars, and their labels: a part of [`crate::names`].

use crate::names::{
    Kind, LABEL_LIDAR, LABEL_REASON, LABEL_REPLICA, LABEL_STAGE, Metric, of_one_stage, with_labels,
};

/// Label: `starting`, `measuring`, `absent`, `gone`, `silent`, `garbled` or `stands`.
pub const LABEL_STATE: &str = "state";
/// Label: the model that a lidar reports.
pub const LABEL_MODEL: &str = "model";
/// Label: the firmware that a lidar reports.
pub const LABEL_FIRMWARE: &str = "firmware";
/// Label: the serial number that a lidar reports.
pub const LABEL_SERIAL_NUMBER: &str = "serial_number";
/// Label: the health that a lidar reports: `good`, or `warning` or `failed` with its code.
pub const LABEL_HEALTH: &str = "health";

const LIDAR_INGEST: &str = "lidar-ingest";
const STAGE_LIDAR: &[&str] = &[LABEL_STAGE, LABEL_REPLICA, LABEL_LIDAR];

/// Scans of each lidar.
pub const LIDAR_SCANS: Metric = with_labels(
    of_one_stage(
        LIDAR_INGEST,
        "flockslam_lidar_scans_total",
        Kind::Counter,
        "Scans of the lidar that were given to the set",
    ),
    STAGE_LIDAR,
);
/// Seconds since each lidar's last scan.
pub const LIDAR_AGE: Metric = with_labels(
    of_one_stage(
        LIDAR_INGEST,
        "flockslam_lidar_last_scan_age_seconds",
        Kind::Gauge,
        "Time since the last scan of the lidar",
    ),
    STAGE_LIDAR,
);
/// What was lost of a lidar's bytes.
pub const LIDAR_LOST: Metric = with_labels(
    of_one_stage(
        LIDAR_INGEST,
        "flockslam_lidar_lost_total",
        Kind::Counter,
        "What was lost on the line to a lidar: packets with a wrong checksum, bytes of no packet, missing packets, partial turns; and changes of its speed",
    ),
    &[LABEL_STAGE, LABEL_REPLICA, LABEL_LIDAR, LABEL_REASON],
);
/// How often a lidar came back.
pub const LIDAR_RETURNS: Metric = with_labels(
    of_one_stage(
        LIDAR_INGEST,
        "flockslam_lidar_returns_total",
        Kind::Counter,
        "How often a lidar measured again after it had been gone, silent or garbled",
    ),
    STAGE_LIDAR,
);
/// How a lidar is.
pub const LIDAR_STATE: Metric = with_labels(
    of_one_stage(
        LIDAR_INGEST,
        "flockslam_lidar_state",
        Kind::Gauge,
        "1 with what is the case with a lidar, and what it says of itself",
    ),
    &[
        LABEL_STAGE,
        LABEL_REPLICA,
        LABEL_LIDAR,
        LABEL_STATE,
        LABEL_MODEL,
        LABEL_FIRMWARE,
        LABEL_SERIAL_NUMBER,
        LABEL_HEALTH,
    ],
);
/// How fast a lidar turns.
pub const LIDAR_SPEED: Metric = with_labels(
    of_one_stage(
        LIDAR_INGEST,
        "flockslam_lidar_speed_hertz",
        Kind::Gauge,
        "Turns a second of a lidar; 0 while none come",
    ),
    STAGE_LIDAR,
);
/// Of lidars on lines of their own; without such lidars these metrics are absent.
pub const OF_LIDAR_LINES: [Metric; 4] = [LIDAR_LOST, LIDAR_RETURNS, LIDAR_STATE, LIDAR_SPEED];
