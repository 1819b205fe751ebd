//! The part of the bridge that publishes map → odom.

use super::{Bridge, FOREIGN_NS};
use crate::ros_bridge::diagnostics_thread::Report;
use crate::ros_bridge::map_correction::{Correction, JUMP_M, JUMP_RAD};
use flockslam_messages::PoseEstimate;
use flockslam_telemetry::monotonic_ns;

impl Bridge {
    /// Time has gone back: what was received of the time before does not count any more.
    pub(super) fn begin_time_anew(&mut self, why: &str) {
        self.times_back += 1;
        // Two clocks in one graph would say it without end.
        if self.times_back.is_power_of_two() {
            let count = self.times_back;
            tracing::warn!(count, "{why}: transforms and what waits are dropped, and map → odom begins anew");
        }
        self.relay.clear();
        self.correction.clear();
    }

    pub(super) fn note_foreign_correction(&mut self) {
        let (map, odom) = (&self.parameters.map_frame, &self.parameters.odom_frame);
        if self.foreign_ns.replace(monotonic_ns()).is_none() {
            tracing::error!("another node publishes {map} → {odom} on /tf: this one does not meanwhile");
        }
    }

    pub(super) fn take_pose(&mut self, estimate: &PoseEstimate) {
        let Some(now_ns) = self.clock.now_ns() else { return };
        self.correction.rate_max_m_s = self.parameters.live.max_correction_rate_m_s.get();
        let scan_ns = estimate.times.sensor_ns;
        if self.clock.is_of_before(scan_ns) {
            return;
        }
        if self.parameters.publish_odom_transform {
            let (odom, base) = (&self.parameters.odom_frame, &self.parameters.base_frame);
            self.publishers.send_transform(scan_ns, odom, base, estimate.odom_from_base);
            let correction = self.correction.set(scan_ns, estimate.map_from_odom, now_ns, self.ahead_ns());
            self.send_correction(&correction);
        } else {
            self.correction.push(scan_ns, estimate.map_from_base(), now_ns);
        }
    }

    fn ahead_ns(&self) -> i64 {
        (self.parameters.live.transform_timeout_s.get() * 1e9) as i64
    }

    pub(super) fn correct(&mut self) {
        let Some(now_ns) = self.clock.now_ns().filter(|_| self.is_active()) else { return };
        let ahead_ns = self.ahead_ns();
        let without = self.correction.without_odometry;
        while let Some(correction) = self.correction.next(self.relay.transforms(), now_ns, ahead_ns) {
            self.send_correction(&correction);
        }
        if self.correction.without_odometry > without {
            self.relay.warn_without_odometry(now_ns);
        }
        let period_ns = (self.parameters.live.transform_publish_period_s.get() * 1e9) as i64;
        if let Some(correction) =
            self.correction.repeated(self.relay.transforms(), now_ns, ahead_ns, period_ns)
        {
            self.send_correction(&correction);
        }
    }

    fn send_correction(&mut self, correction: &Correction) {
        if self.has_foreign_correction() {
            return;
        }
        if correction.jump.0 > JUMP_M || correction.jump.1 > JUMP_RAD {
            // It stands before its transform.
            let _ = self.reports.send(Report::Jump(*correction, correction.stamp_ns));
        }
        let (map, odom) = (&self.parameters.map_frame, &self.parameters.odom_frame);
        self.publishers.send_transform(correction.stamp_ns, map, odom, correction.map_from_odom);
        if let Some(received) = correction.scan_ns.and_then(|scan_ns| self.relay.came(scan_ns)) {
            self.latency.record(received.elapsed().as_nanos() as u64);
        }
    }

    fn has_foreign_correction(&mut self) -> bool {
        let is_past = |received_ns: u64| monotonic_ns().saturating_sub(received_ns) > FOREIGN_NS;
        if self.foreign_ns.is_some_and(is_past) {
            self.foreign_ns = None;
            tracing::info!("no other node corrects odometry any more: this one does again");
        }
        self.foreign_ns.is_some()
    }
}
