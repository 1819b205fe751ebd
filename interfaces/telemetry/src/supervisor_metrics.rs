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
    shared_memory: IntGauge,
}

impl SupervisorMetrics {
    /// Metrics of a set of these stages; all start as down, with no restart.
    pub fn new(stage_names: &[&str]) -> Self {
        let registry = Registry::new();
        let restarts =
            registered(&registry, IntCounterVec::new(opts(names::STAGE_RESTARTS), &[names::LABEL_STAGE]));
        let up = registered(&registry, IntGaugeVec::new(opts(names::STAGE_UP), &[names::LABEL_STAGE]));
        for stage in stage_names {
            restarts.with_label_values(&[*stage]);
            up.with_label_values(&[*stage]);
        }
        let shared_memory = registered(&registry, IntGauge::with_opts(opts(names::SHARED_MEMORY)));
        Self { registry, restarts, up, shared_memory }
    }

    /// Counts a restart of a stage.
    pub fn restarted(&self, stage_name: &str) {
        self.restarts.with_label_values(&[stage_name]).inc();
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
        let text = metrics.render();
        for line in [
            r#"flockslam_stage_restarts_total{stage="mapper"} 1"#,
            r#"flockslam_stage_restarts_total{stage="scan-matcher"} 0"#,
            r#"flockslam_stage_up{stage="mapper"} 0"#,
            r#"flockslam_stage_up{stage="scan-matcher"} 1"#,
            "flockslam_shared_memory_bytes 4096",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} is missing in\n{text}");
        }
    }
}
