use crate::names::{self, Metric};
use crate::stage_metrics::registered;
use prometheus::{IntCounterVec, IntGauge, IntGaugeVec, Opts, Registry, TextEncoder};

/// What the supervisor says of its process set; its page is merged with those of the stages. Clones share the same
/// numbers.
#[derive(Clone)]
pub struct SupervisorMetrics {
    registry: Registry,
    restarts: IntCounterVec,
    up: IntGaugeVec,
    hangs: IntCounterVec,
    degraded: IntGaugeVec,
    not_durable: IntGauge,
    shared_memory: IntGauge,
}

impl SupervisorMetrics {
    /// Metrics of a set of these stages; all start as down, with no restart.
    pub fn new(stage_names: &[&str]) -> Self {
        let registry = Registry::new();
        let restarts =
            registered(&registry, IntCounterVec::new(opts(names::STAGE_RESTARTS), &[names::LABEL_STAGE]));
        let up = registered(&registry, IntGaugeVec::new(opts(names::STAGE_UP), &[names::LABEL_STAGE]));
        let hangs =
            registered(&registry, IntCounterVec::new(opts(names::STAGE_HANGS), &[names::LABEL_STAGE]));
        let degraded =
            registered(&registry, IntGaugeVec::new(opts(names::STAGE_DEGRADED), &[names::LABEL_STAGE]));
        for stage in stage_names {
            hangs.with_label_values(&[*stage]);
            degraded.with_label_values(&[*stage]);
            restarts.with_label_values(&[*stage]);
            up.with_label_values(&[*stage]);
        }
        let shared_memory = registered(&registry, IntGauge::with_opts(opts(names::SHARED_MEMORY)));
        let not_durable = registered(&registry, IntGauge::with_opts(opts(names::NOT_DURABLE)));
        Self { registry, restarts, up, hangs, degraded, not_durable, shared_memory }
    }

    /// Counts a restart of a stage.
    pub fn restarted(&self, stage_name: &str) {
        self.restarts.with_label_values(&[stage_name]).inc();
    }

    /// Counts a stage that was replaced because it hung.
    pub fn hung(&self, stage_name: &str) {
        self.hangs.with_label_values(&[stage_name]).inc();
    }

    /// Notes whether the set goes on without a stage that does not get up.
    pub fn set_degraded(&self, stage_name: &str, degraded: bool) {
        self.degraded.with_label_values(&[stage_name]).set(i64::from(degraded));
    }

    /// Notes whether the map can be saved to disk.
    pub fn set_not_durable(&self, not_durable: bool) {
        self.not_durable.set(i64::from(not_durable));
    }

    /// Notes whether a stage runs and answers.
    pub fn set_up(&self, stage_name: &str, up: bool) {
        self.up.with_label_values(&[stage_name]).set(i64::from(up));
    }

    /// Notes the bytes of shared memory of the whole set.
    pub fn set_shared_memory(&self, bytes: u64) {
        self.shared_memory.set(i64::try_from(bytes).unwrap_or(i64::MAX));
    }

    /// All metrics in the Prometheus text format.
    pub fn render(&self) -> String {
        TextEncoder::new()
            .encode_to_string(&self.registry.gather())
            .expect("metrics with constant names can always be written")
    }
}

fn opts(metric: Metric) -> Opts {
    Opts::new(metric.name, metric.help)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stage_has_its_series_from_the_start() {
        let metrics = SupervisorMetrics::new(&["mapper", "scan-matcher"]);
        metrics.restarted("mapper");
        metrics.set_up("scan-matcher", true);
        metrics.set_shared_memory(4096);
        metrics.hung("mapper");
        metrics.set_degraded("scan-matcher", true);
        let text = metrics.render();
        for line in [
            r#"flockslam_stage_restarts_total{stage="mapper"} 1"#,
            r#"flockslam_stage_restarts_total{stage="scan-matcher"} 0"#,
            r#"flockslam_stage_up{stage="mapper"} 0"#,
            r#"flockslam_stage_up{stage="scan-matcher"} 1"#,
            r#"flockslam_stage_hangs_total{stage="mapper"} 1"#,
            r#"flockslam_stage_degraded{stage="mapper"} 0"#,
            r#"flockslam_stage_degraded{stage="scan-matcher"} 1"#,
            "flockslam_not_durable 0",
            "flockslam_shared_memory_bytes 4096",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} is missing in\n{text}");
        }
    }
}
