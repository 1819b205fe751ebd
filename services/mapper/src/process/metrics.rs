//! Metrics and log lines about the map.

use crate::Mapper;
use flockslam_telemetry::{Gauge, StageMetrics, names};

/// What the stage tells of its map.
pub struct MapMetrics {
    submaps: Gauge,
    live_tiles: Gauge,
}

impl MapMetrics {
    /// Adds them to the stage's metrics.
    pub fn new(metrics: &StageMetrics) -> Self {
        Self { submaps: metrics.gauge(names::SUBMAPS), live_tiles: metrics.gauge(names::LIVE_TILES) }
    }

    /// Tells of a scan that entered the map, and of how many cells were cleared with it.
    pub fn inserted(&self, scan: u64, cleared: usize) {
        tracing::debug!(scan, cleared, "inserted");
    }

    /// Tells how the map is; its live tiles.
    pub fn look(&self, map: &Mapper) -> usize {
        let tiles = map.live_tiles().count();
        self.live_tiles.set(tiles as f64);
        self.submaps.set(f64::from(map.active_submap()));
        tiles
    }
}
