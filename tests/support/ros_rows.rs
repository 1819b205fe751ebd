//! Rows of what a robot in a graph has noted: scans that it has sent, poses and corrections that it has received.

use flockslam_geometry::Pose;
use serde_json::Value;

/// map → odom is stamped so much ahead of its scan.
pub const AHEAD_NS: i64 = 200_000_000;
/// Without poses the last correction is repeated for a second; its stamps go on for so long.
pub const REPEATED_MAX_NS: i64 = 1_500_000_000;
/// A pose that is put together of odometry and correction is that of the scan, metres.
const COMPOSED_MAX_M: f64 = 1e-3;

/// Stamp, pose, and when it was sent or received.
pub type Row = (i64, Pose, i64);

/// Rows of numbers: a stamp and a pose, and whatever follows.
pub fn rows(noted: &Value, name: &str) -> Vec<Row> {
    let row = |row: &Value| {
        let number = |index: usize| row[index].as_f64().unwrap();
        (row[0].as_i64().unwrap(), Pose::new(number(1), number(2), number(3)), row[4].as_i64().unwrap())
    };
    noted[name].as_array().unwrap().iter().map(row).collect()
}

/// A scan's odometry and a correction of its time give its pose; returns when that correction was received.
pub fn assert_composed((scan_ns, odom_from_base, _): &Row, pose: Pose, corrections: &[Row]) -> i64 {
    // Where a pose is late, one that is repeated between scans has its stamp, and its own the next; none is repeated for longer than that.
    let times = scan_ns + AHEAD_NS..scan_ns + AHEAD_NS + REPEATED_MAX_NS;
    let is_own =
        |row: &&Row| times.contains(&row.0) && (row.1 * *odom_from_base).distance_m(pose) < COMPOSED_MAX_M;
    let own = corrections.iter().find(is_own);
    let missing = || {
        let (count, first) = (corrections.len(), corrections.first());
        panic!(
            "no correction of {count}, the first {first:?}, leads from {odom_from_base:?} to {pose:?} at {scan_ns}"
        )
    };
    own.unwrap_or_else(missing).2
}
