//! Metrics and log lines about the map.

use crate::Mapper;
use flockslam_telemetry::{Gauge, StageMetrics, names};

/// Metrics of the map.
pub struct MapMetrics {
    submaps: Gauge,
    live_tiles: Gauge,
}

impl MapMetrics {
    /// Adds them to the stage's metrics.
    pub fn new(metrics: &StageMetrics) -> Self {
        Self { submaps: metrics.gauge(names::SUBMAPS), live_tiles: metrics.gauge(names::LIVE_TILES) }
    }

    /// Counts a scan that entered the map, and the cells that were cleared with it.
    pub fn inserted(&self, scan: u64, cleared: usize) {
        tracing::debug!(scan, cleared, "inserted");
    }

    /// Updates the metrics of the map; gives the number of its live tiles.
    pub fn look(&self, map: &Mapper) -> usize {
        let tiles = map.live_tiles().count();
        self.live_tiles.set(tiles as f64);
        self.submaps.set(f64::from(map.active_submap()));
        tiles
    }
}
