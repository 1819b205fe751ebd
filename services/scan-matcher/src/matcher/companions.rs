//! Beams that lie on other robots, which say where they are, are set aside.

use super::ScanMatcher;
use crate::motion::Prediction;
use flockslam_geometry::Point;
use flockslam_messages::ScanView;

/// What a robot said this long ago, seconds, says nothing any more.
const AGE_MAX_S: f64 = 2.0;
/// So much farther it may be for each second since, metres.
const SPEED_M_S: f64 = 0.5;

impl ScanMatcher {
    /// Takes the points that end on another robot out of those to be matched; their beams are told as moving. A robot that stands still
    /// would be a piece of wall otherwise.
    pub(super) fn set_companions_aside(&mut self, scan: ScanView<'_>, prediction: &Prediction) {
        let odom_from_map = self.map_from_odom.inverse();
        let base_from_odom = prediction.pose.inverse();
        let now_ns = scan.header().times.monotonic_ns;
        let stride = self.stride(scan) as u32;
        let companions = self.companions;
        for robot in companions.as_slice() {
            let age_s = now_ns.saturating_sub(robot.heard_ns) as f64 * 1e-9;
            if age_s > AGE_MAX_S {
                continue;
            }
            let odom_from_robot = odom_from_map * robot.map_from_base;
            let center = base_from_odom.apply(Point::new(odom_from_robot.x_m, odom_from_robot.y_m));
            let radius_m = robot.radius_m + SPEED_M_S * age_s;
            self.set_aside.clear();
            self.set_aside.extend(self.points.iter().map(|point| point.distance_m(center) <= radius_m));
            self.tell_and_leave_out(stride);
        }
    }

    fn tell_and_leave_out(&mut self, stride: u32) {
        if !self.set_aside.contains(&true) {
            return;
        }
        for i in (0..self.points.len()).filter(|i| self.set_aside[*i]) {
            super::movers::add_beams(&mut self.moving, 0, self.beams[i], stride);
        }
        self.leave_out_what_is_aside();
    }
}
