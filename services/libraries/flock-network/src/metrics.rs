//! Metrics of the flock: takes a status and counts of drops, brings gauges and counters up to them.

use super::drops::Dropped;
use super::link::OTHERS;
use flockslam_results::FlockStatus;
use flockslam_telemetry::{Counter, CountersByLabels, Gauge, LabelledCounters, StageMetrics, names};
use std::collections::BTreeMap;

/// Metrics of the flock.
pub struct FlockMetrics {
    peers: Gauge,
    near: Gauge,
    members: Gauge,
    records: Gauge,
    record_bytes: Gauge,
    closures: Gauge,
    conflicts: Gauge,
    searches: Counter,
    peer_bytes: CountersByLabels,
    dropped: LabelledCounters,
    counted: BTreeMap<String, (u64, u64)>,
    counted_searches: u64,
    counted_drops: [u64; Dropped::ALL.len()],
}

impl FlockMetrics {
    /// Adds them to the stage's metrics.
    pub fn new(metrics: &StageMetrics) -> Self {
        let reasons = Dropped::ALL.map(Dropped::name);
        let peer_bytes =
            metrics.counters_by(names::FLOCK_PEER_BYTES, &[names::LABEL_PEER, names::LABEL_DIRECTION]);
        // Something is there to be seen before anybody was met.
        ["received", "sent"].into_iter().for_each(|direction| peer_bytes.count_by(&[OTHERS, direction], 0));
        Self {
            peers: metrics.gauge(names::FLOCK_PEERS),
            near: metrics.gauge(names::FLOCK_NEAR),
            members: metrics.gauge(names::FLOCK_MEMBERS),
            records: metrics.gauge(names::FLOCK_RECORDS),
            record_bytes: metrics.gauge(names::FLOCK_RECORD_BYTES),
            closures: metrics.gauge(names::FLOCK_CLOSURES),
            conflicts: metrics.gauge(names::FLOCK_CONFLICTS),
            searches: metrics.counter(names::FLOCK_SEARCHES),
            peer_bytes,
            dropped: metrics.counters(names::FLOCK_DROPPED, names::LABEL_REASON, &reasons),
            counted: BTreeMap::new(),
            counted_searches: 0,
            counted_drops: [0; Dropped::ALL.len()],
        }
    }

    /// Brings them up to this state and these counts of drops.
    pub fn show(&mut self, status: &FlockStatus, drops: [u64; Dropped::ALL.len()]) {
        self.peers.set(status.peers.len() as f64);
        self.near.set(status.near.len() as f64);
        self.members.set(if status.merged { status.members.len() as f64 } else { 0.0 });
        self.records.set(status.records.0 as f64);
        self.record_bytes.set(status.records.1 as f64);
        self.closures.set(status.across.0 as f64);
        self.conflicts.set(status.across.1 as f64);
        self.searches.inc_by(status.searches - self.counted_searches);
        self.counted_searches = status.searches;
        for (peer, (received, sent)) in &status.traffic {
            let before = self.counted.insert(peer.clone(), (*received, *sent)).unwrap_or_default();
            self.peer_bytes.count_by(&[peer, "received"], received - before.0);
            self.peer_bytes.count_by(&[peer, "sent"], sent - before.1);
        }
        for (place, (now, before)) in drops.iter().zip(self.counted_drops).enumerate() {
            self.dropped.count_by(place, now - before);
        }
        self.counted_drops = drops;
    }
}
