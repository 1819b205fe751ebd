//! A published pose, as the back end keeps it.

use flockslam_messages::{DropReason, PoseEstimate, PoseFlags, Quality, ScanId};
use flockslam_registration::cloud::Placement;

/// A published pose, as kept for the final trajectory.
#[derive(Clone, Copy, Debug)]
pub struct PoseRecord {
    /// The scan.
    pub id: ScanId,
    /// Sensor stamp, nanoseconds.
    pub stamp_ns: i64,
    /// The front end's pose, continuous.
    pub odom: Placement,
    /// Odometry, when the robot has it.
    pub odometry: Option<Placement>,
    /// Submap that the scan entered, if it was inserted.
    pub submap: u32,
    /// Trajectory that it belongs to.
    pub trajectory: u32,
    /// It is one of an imported map, not one of a drive.
    pub is_given: bool,
    /// The front end rejected its fit.
    pub lost: bool,
    /// It begins a trajectory that odometry connects with the one before.
    pub continues: bool,
}

impl PoseRecord {
    /// The part of a published pose that is kept.
    pub fn new(pose: &PoseEstimate) -> Self {
        Self {
            id: pose.id,
            stamp_ns: pose.times.sensor_ns,
            odom: pose.odom_from_base.into(),
            odometry: pose.has(PoseFlags::HAS_ODOMETRY).then(|| pose.odometry.into()),
            submap: pose.submap,
            trajectory: pose.trajectory,
            is_given: pose.has(PoseFlags::IMPORTED),
            lost: pose.quality == Quality::Lost as u32,
            continues: pose.has(PoseFlags::CONTINUES),
        }
    }
}

/// Whether the points of the scan with this pose show its pose: it was matched, or it was dropped without having been tried. A scan that
/// the front end has not matched gives no pose, nor does one that the source withheld.
pub fn gives_a_place(pose: &PoseEstimate) -> bool {
    let untried = [DropReason::Correlated, DropReason::Unchanged, DropReason::Motion, DropReason::Overload];
    let is_untried =
        !pose.has(PoseFlags::OVERRIDDEN) && untried.iter().any(|r| *r as u32 == pose.drop_reason);
    pose.has(PoseFlags::MATCHED) || is_untried
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_matched_and_untried_scans_give_a_pose() {
        let pose = |flags, drop_reason: u32| PoseEstimate { flags, drop_reason, ..PoseEstimate::default() };
        let tried = pose(PoseFlags::OVERRIDDEN, DropReason::Correlated as u32);
        let (kept, correlated) = (pose(0, 0), pose(0, DropReason::Correlated as u32));
        let withheld = pose(0, DropReason::Withheld as u32);
        let matched = pose(PoseFlags::MATCHED | PoseFlags::OVERRIDDEN, DropReason::Correlated as u32);
        let says = [tried, kept, correlated, withheld, matched].map(|pose| gives_a_place(&pose));
        assert_eq!(says, [false, false, true, false, true]);
    }
}
