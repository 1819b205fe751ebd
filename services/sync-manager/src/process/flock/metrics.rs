use super::drops::Dropped;
use flockslam_stage::FlockStatus;
use flockslam_telemetry::{Counter, Gauge, LabelledCounters, StageMetrics, names};

/// What the stage tells of its flock.
pub struct FlockMetrics {
    peers: Gauge,
    members: Gauge,
    record_bytes: Gauge,
    said: Counter,
    heard: Counter,
    dropped: LabelledCounters,
    counted: (u64, u64),
    counted_drops: [u64; Dropped::ALL.len()],
}

impl FlockMetrics {
    /// Adds them to the stage's metrics.
    pub fn new(metrics: &StageMetrics) -> Self {
        let reasons = Dropped::ALL.map(Dropped::name);
        Self {
            peers: metrics.gauge(names::FLOCK_PEERS),
            members: metrics.gauge(names::FLOCK_MEMBERS),
            record_bytes: metrics.gauge(names::FLOCK_RECORD_BYTES),
            said: metrics.counter(names::FLOCK_SAID),
            heard: metrics.counter(names::FLOCK_HEARD),
            dropped: metrics.counters(names::FLOCK_DROPPED, names::LABEL_REASON, &reasons),
            counted: (0, 0),
            counted_drops: [0; Dropped::ALL.len()],
        }
    }

    /// Brings them up to this state and these counts of drops.
    pub fn show(&mut self, status: &FlockStatus, drops: [u64; Dropped::ALL.len()]) {
        self.peers.set(status.peers.len() as f64);
        self.members.set(if status.merged { status.members.len() as f64 } else { 0.0 });
        self.record_bytes.set(status.records.1 as f64);
        self.said.inc_by(status.said_bytes - self.counted.0);
        self.heard.inc_by(status.heard_bytes - self.counted.1);
        self.counted = (status.said_bytes, status.heard_bytes);
        for (place, (now, before)) in drops.iter().zip(self.counted_drops).enumerate() {
            self.dropped.count_by(place, now - before);
        }
        self.counted_drops = drops;
    }
}
