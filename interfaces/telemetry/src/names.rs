//! Every metric of the system: name, help text, buckets. Names follow the Prometheus conventions (base units, one
//! prefix); dashboards and rules refer to these names and no others.

/// What all names begin with.
pub const PREFIX: &str = "flockslam_";

/// Label: the stage that speaks, for example `scan-matcher`.
pub const LABEL_STAGE: &str = "stage";
/// Label: which replica of the stage, from 0.
pub const LABEL_REPLICA: &str = "replica";
/// Label: why something was dropped.
pub const LABEL_REASON: &str = "reason";

/// A metric's name and its help text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metric {
    /// Full name.
    pub name: &'static str,
    /// One line for people.
    pub help: &'static str,
}

/// Histogram of seconds in one stage's `handle` per scan.
pub const STAGE_LATENCY: Metric = Metric {
    name: "flockslam_stage_latency_seconds",
    help: "Time that the stage's own logic took for one scan",
};
/// Histogram of seconds from the capture of a scan to the stage's output for it.
pub const SCAN_TO_OUTPUT: Metric = Metric {
    name: "flockslam_scan_to_output_seconds",
    help: "Time from the capture of a scan to the output of the stage for it",
};
/// Counter of scans that the stage has handled.
pub const SCANS_HANDLED: Metric =
    Metric { name: "flockslam_scans_handled_total", help: "Scans that the stage has handled" };
/// Counter of scans or messages that the stage has dropped, by `reason`.
pub const DROPPED: Metric =
    Metric { name: "flockslam_dropped_total", help: "Scans or messages that the stage has dropped" };
/// Counter of scans that the filter let pass, by `reason`.
pub const KEPT: Metric = Metric { name: "flockslam_kept_total", help: "Scans that the filter let pass" };
/// Gauge: sequence number of the last handled scan.
pub const LAST_SCAN_SEQUENCE: Metric = Metric {
    name: "flockslam_last_scan_sequence",
    help: "Sequence number of the last scan that the stage has handled",
};
/// Gauge: CLOCK_MONOTONIC seconds of the last sign of life.
pub const HEARTBEAT: Metric = Metric {
    name: "flockslam_heartbeat_monotonic_seconds",
    help: "Monotonic clock at the last sign of life of the stage",
};

/// Supervisor's counter of restarts, by `stage`.
pub const STAGE_RESTARTS: Metric =
    Metric { name: "flockslam_stage_restarts_total", help: "Restarts of the stage by the supervisor" };
/// Supervisor's gauge: 1 when the stage's metrics could be read, by `stage`.
pub const STAGE_UP: Metric =
    Metric { name: "flockslam_stage_up", help: "1 when the stage runs and answers, 0 otherwise" };
/// Supervisor's gauge: bytes of shared memory held by the process set.
pub const SHARED_MEMORY: Metric =
    Metric { name: "flockslam_shared_memory_bytes", help: "Shared memory of the whole process set" };

/// Supervisor's counter of stages that were replaced because they gave no sign of life, by `stage`.
pub const STAGE_HANGS: Metric =
    Metric { name: "flockslam_stage_hangs_total", help: "Replacements of the stage because it hung" };
/// Supervisor's gauge: 1 when the stage does not get up and the set goes on without it, by `stage`.
pub const STAGE_DEGRADED: Metric = Metric {
    name: "flockslam_stage_degraded",
    help: "1 when the stage does not get up and the set goes on without it",
};
/// Supervisor's gauge: 1 when the map cannot be saved to disk.
pub const NOT_DURABLE: Metric =
    Metric { name: "flockslam_not_durable", help: "1 when the map cannot be saved to disk" };

/// All metrics, in the order of their names.
pub const ALL: [Metric; 13] = [
    DROPPED,
    HEARTBEAT,
    KEPT,
    LAST_SCAN_SEQUENCE,
    NOT_DURABLE,
    SCAN_TO_OUTPUT,
    SCANS_HANDLED,
    SHARED_MEMORY,
    STAGE_DEGRADED,
    STAGE_HANGS,
    STAGE_LATENCY,
    STAGE_RESTARTS,
    STAGE_UP,
];

/// Upper bounds of the latency buckets, seconds: 10 µs … 1 s in steps of 2 to 2.5.
pub const LATENCY_BUCKETS_S: [f64; 16] = [
    10e-6, 20e-6, 50e-6, 100e-6, 200e-6, 500e-6, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 100e-3, 200e-3,
    500e-3, 1.0,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_prefixed_and_in_base_units() {
        assert!(LATENCY_BUCKETS_S.is_sorted());
        for metric in ALL {
            assert!(metric.name.starts_with(PREFIX) && !metric.help.is_empty());
            assert!(metric.name.bytes().all(|b| b.is_ascii_lowercase() || b == b'_'), "{}", metric.name);
            assert!(!metric.name.contains("micro") && !metric.name.contains("milli"));
            assert_eq!(ALL.iter().filter(|other| other.name == metric.name).count(), 1);
        }
    }
}
