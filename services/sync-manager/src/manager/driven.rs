//! How much was driven in each trajectory, counted as the poses come.

use crate::pose_record::PoseRecord;
use flockslam_loop_closure::connectivity::TrajectoryConnectivity;
use flockslam_registration::cloud::Placement;
use flockslam_results::Unattached;
use std::collections::BTreeMap;

/// Steps shorter than this are no travel, metres: the pose of a robot that stands trembles.
const STEP_MIN_M: f64 = 0.05;

/// The poses so far, summed up by trajectory.
#[derive(Default)]
pub(super) struct Driven {
    begin_ns: Option<i64>,
    trajectories: BTreeMap<u32, Stretch>,
}

struct Stretch {
    scans: u64,
    travel_m: f64,
    begin_ns: i64,
    at: Placement,
}

impl Driven {
    /// Counts a pose.
    pub(super) fn count(&mut self, record: &PoseRecord) {
        self.begin_ns.get_or_insert(record.stamp_ns);
        let new = Stretch { scans: 0, travel_m: 0.0, begin_ns: record.stamp_ns, at: record.odom };
        let stretch = self.trajectories.entry(record.trajectory).or_insert(new);
        stretch.scans += 1;
        let step_m = stretch.at.distance_m(&record.odom);
        if step_m >= STEP_MIN_M {
            (stretch.travel_m, stretch.at) = (stretch.travel_m + step_m, record.odom);
        }
    }

    /// What is not attached.
    pub(super) fn unattached(&self, connectivity: &TrajectoryConnectivity) -> Unattached {
        let begin_ns = self.begin_ns.unwrap_or(0);
        let seconds = |stamp_ns: i64| stamp_ns.saturating_sub(begin_ns) as f64 * 1e-9;
        let apart = self.trajectories.iter().filter(|(number, _)| !connectivity.is_attached(**number));
        apart.fold(Unattached::default(), |sum, (_, stretch)| Unattached {
            since_s: if sum.scans == 0 { seconds(stretch.begin_ns) } else { sum.since_s },
            scans: sum.scans + stretch.scans,
            travel_m: sum.travel_m + stretch.travel_m,
        })
    }
}
