//! Beams that lie on other robots with known poses are set aside.

use super::points::add_beams;
use super::{MoverMask, ScanMatcher, ScanPoints};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::ScanView;

/// A published pose that is older than this, seconds, is not used.
const AGE_MAX_S: f64 = 2.0;
/// The other robot may have moved so far in each second since, metres.
const SPEED_M_S: f64 = 0.5;

impl ScanMatcher {
    /// Removes the points on other robots from those to be matched; their beams are published as moving. A robot that stands still
    /// would otherwise enter the map as a wall. `pose` is the predicted pose of this robot, in odom.
    pub(super) fn without_flock_robots(
        &self,
        scan: ScanView<'_>,
        mut points: ScanPoints,
        mut mask: MoverMask,
        pose: Pose,
    ) -> (ScanPoints, MoverMask) {
        let odom_from_map = self.map.map_from_odom.inverse();
        let base_from_odom = pose.inverse();
        let now_ns = scan.header().times.monotonic_ns;
        for robot in self.flock_robots.as_slice() {
            let age_s = now_ns.saturating_sub(robot.received_ns) as f64 * 1e-9;
            if age_s > AGE_MAX_S {
                continue;
            }
            let odom_from_robot = odom_from_map * robot.map_from_base;
            let center = base_from_odom.apply(Point::new(odom_from_robot.x_m, odom_from_robot.y_m));
            let radius_m = robot.radius_m + SPEED_M_S * age_s;
            mask.marks.clear();
            mask.marks.extend(points.ends.iter().map(|end| end.distance_m(center) <= radius_m));
            for i in (0..points.len()).filter(|i| mask.marks[*i]) {
                add_beams(&mut mask.moving, 0, points.beams[i], points.stride);
            }
            points = points.without(&mask.marks);
        }
        (points, mask)
    }
}
