//! Metrics and log lines about published poses.

use flockslam_messages::{PoseEstimate, PoseFlags};
use flockslam_telemetry::{Counter, Histogram, LabelledCounters, StageMetrics, names};

/// Metrics of the poses.
pub struct PoseMetrics {
    qualities: LabelledCounters,
    score: Histogram,
    position_std_m: Histogram,
    heading_std_rad: Histogram,
    rescues: Counter,
    overruled: Counter,
    accepted: Counter,
}

impl PoseMetrics {
    /// Adds them to the stage's metrics.
    pub fn new(metrics: &StageMetrics) -> Self {
        // In the order of the numbers of `Quality`.
        let qualities = ["tracking", "degraded", "lost"];
        Self {
            qualities: metrics.counters(names::POSES, names::LABEL_QUALITY, &qualities),
            score: metrics.histogram(names::MATCH_SCORE),
            position_std_m: metrics.histogram(names::POSITION_STD),
            heading_std_rad: metrics.histogram(names::HEADING_STD),
            rescues: metrics.counter(names::RESCUE_SEARCHES),
            overruled: metrics.counter(names::OVERRULED),
            accepted: metrics.counter(names::SCANS_ACCEPTED),
        }
    }

    /// Counts a published pose, and logs it.
    pub fn published(&self, pose: &PoseEstimate) {
        let (scan, matched, accepted) =
            (pose.id.sequence, pose.has(PoseFlags::MATCHED), pose.has(PoseFlags::INSERT));
        tracing::debug!(scan, matched, accepted, quality = pose.quality, score = pose.score, "pose");
        self.qualities.count(pose.quality.min(2) as usize);
        let counted = [
            (PoseFlags::RESCUED, &self.rescues),
            (PoseFlags::OVERRIDDEN, &self.overruled),
            (PoseFlags::INSERT, &self.accepted),
        ];
        counted.iter().filter(|(flag, _)| pose.has(*flag)).for_each(|(_, counter)| counter.inc());
        if pose.has(PoseFlags::MATCHED) {
            self.score.observe(pose.score);
            self.position_std_m.observe(pose.covariance.position_std_m());
            self.heading_std_rad.observe(pose.covariance.tt.max(0.0).sqrt());
        }
    }
}
