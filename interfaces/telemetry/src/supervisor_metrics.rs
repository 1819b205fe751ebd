//! The metrics of the supervisor: restarts, hangs and state of each stage, and the memory of the set.

use crate::names::{self, Metric};
use crate::process_use::ProcessUse;
use crate::registered::registered;
use prometheus::{GaugeVec, IntCounterVec, IntGauge, IntGaugeVec, Opts, Registry, TextEncoder};

/// Metrics of the supervisor about its process set; its page is merged with those of the stages. Clones share the same
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
    heartbeat_age: GaugeVec,
    process: ProcessUse,
}

/// Why a stage was started again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RestartReason {
    /// Its process ended by itself, or something from outside killed it.
    #[default]
    Died,
    /// It gave no sign of life and was killed.
    Hung,
    /// It was requested.
    Ordered,
}

impl RestartReason {
    /// All reasons.
    pub const ALL: [RestartReason; 3] = [Self::Died, Self::Hung, Self::Ordered];

    /// The name used in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Died => "died",
            Self::Hung => "hung",
            Self::Ordered => "ordered",
        }
    }
}

impl SupervisorMetrics {
    /// Metrics of a set of these stages; all start as down, with no restart.
    pub fn new(stage_names: &[&str]) -> Self {
        let registry = Registry::new();
        let restarts = registered(
            &registry,
            IntCounterVec::new(opts(names::STAGE_RESTARTS), &[names::LABEL_STAGE, names::LABEL_REASON]),
        );
        let up = registered(&registry, IntGaugeVec::new(opts(names::STAGE_UP), &[names::LABEL_STAGE]));
        let hangs =
            registered(&registry, IntCounterVec::new(opts(names::STAGE_HANGS), &[names::LABEL_STAGE]));
        let degraded =
            registered(&registry, IntGaugeVec::new(opts(names::STAGE_DEGRADED), &[names::LABEL_STAGE]));
        for stage in stage_names {
            hangs.with_label_values(&[*stage]);
            degraded.with_label_values(&[*stage]);
            RestartReason::ALL.iter().for_each(|why| drop(restarts.with_label_values(&[*stage, why.name()])));
            up.with_label_values(&[*stage]);
        }
        let shared_memory = registered(&registry, IntGauge::with_opts(opts(names::SHARED_MEMORY)));
        let not_durable = registered(&registry, IntGauge::with_opts(opts(names::NOT_DURABLE)));
        let heartbeat_age = registered(
            &registry,
            GaugeVec::new(opts(names::HEARTBEAT_AGE), &[names::LABEL_STAGE, names::LABEL_REPLICA]),
        );
        let own = |metric| {
            opts(metric).const_label(names::LABEL_STAGE, "supervisor").const_label(names::LABEL_REPLICA, "0")
        };
        let process = ProcessUse::new(&registry, &own);
        Self { registry, restarts, up, hangs, degraded, not_durable, shared_memory, heartbeat_age, process }
    }

    /// Counts a restart of a stage.
    pub fn restarted(&self, stage_name: &str, why: RestartReason) {
        self.restarts.with_label_values(&[stage_name, why.name()]).inc();
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

    /// Notes how long ago a process of a stage gave its last sign of life, seconds.
    pub fn set_heartbeat_age(&self, stage_name: &str, replica: u32, age_s: f64) {
        self.heartbeat_age.with_label_values(&[stage_name, &replica.to_string()]).set(age_s);
    }

    /// All metrics in the Prometheus text format.
    pub fn render(&self) -> String {
        self.process.look();
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
        let text = metrics.render();
        for stage in ["mapper", "scan-matcher"] {
            let of_stage = |name: &str| format!("flockslam_stage_{name}{{stage=\"{stage}\"}} 0");
            let restarts = RestartReason::ALL.map(|why| {
                format!("flockslam_stage_restarts_total{{reason=\"{}\",stage=\"{stage}\"}} 0", why.name())
            });
            for line in restarts.into_iter().chain(["up", "hangs_total", "degraded"].map(of_stage)) {
                assert!(text.lines().any(|l| l == line), "{line} is missing in\n{text}");
            }
        }
        metrics.restarted("mapper", RestartReason::Hung);
        metrics.set_heartbeat_age("mapper", 1, 0.25);
        metrics.set_up("scan-matcher", true);
        metrics.set_shared_memory(4096);
        metrics.hung("mapper");
        metrics.set_degraded("scan-matcher", true);
        let text = metrics.render();
        for line in [
            r#"flockslam_stage_restarts_total{reason="died",stage="mapper"} 0"#,
            r#"flockslam_stage_restarts_total{reason="hung",stage="mapper"} 1"#,
            r#"flockslam_stage_restarts_total{reason="ordered",stage="scan-matcher"} 0"#,
            r#"flockslam_heartbeat_age_seconds{replica="1",stage="mapper"} 0.25"#,
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
