//! Metrics of the back end: searches, closures, time for each closed submap and area of the map.

use crate::ClosureCounts;
use flockslam_results::Unattached;
use flockslam_telemetry::{Counter, Gauge, Histogram, StageMetrics, names};

/// Metrics of loop closures, time and map.
pub struct CorrectionMetrics {
    searches: Counter,
    accepted: Counter,
    revoked: Gauge,
    optimisation: Histogram,
    area: Gauge,
    unattached: [Gauge; 2],
    seen: ClosureCounts,
}

impl CorrectionMetrics {
    /// Adds them to the stage's metrics.
    pub fn new(metrics: &StageMetrics) -> Self {
        Self {
            searches: metrics.counter(names::CLOSURE_SEARCHES),
            accepted: metrics.counter(names::CLOSURES_ACCEPTED),
            revoked: metrics.gauge(names::CLOSURES_REVOKED),
            optimisation: metrics.histogram(names::OPTIMISATION),
            area: metrics.gauge(names::MAP_AREA),
            unattached: [names::UNATTACHED_SCANS, names::UNATTACHED_TRAVEL]
                .map(|metric| metrics.gauge(metric)),
            seen: ClosureCounts::default(),
        }
    }

    /// Notes the present counts without counting them: another process has done it.
    pub fn recovered(&mut self, counts: ClosureCounts) {
        self.seen = counts;
        self.revoked.set(counts.revoked as f64);
    }

    /// Shows what nothing connects with the map.
    pub fn unattached(&self, now: &Unattached) {
        let [scans, travel] = &self.unattached;
        scans.set(now.scans as f64);
        travel.set(now.travel_m);
    }

    /// Counts the closures after a closed submap, and the time for it, nanoseconds.
    pub fn concluded(&mut self, counts: ClosureCounts, took_ns: u64, map_area_m2: f64) {
        self.searches.inc_by(counts.searches.saturating_sub(self.seen.searches));
        self.accepted.inc_by(counts.accepted.saturating_sub(self.seen.accepted));
        self.recovered(counts);
        self.optimisation.observe(took_ns as f64 * 1e-9);
        self.area.set(map_area_m2);
    }
}
