//! The metrics of a stage: handles for recording, and the page in the Prometheus text format.

use crate::monotonic_ns;
use crate::names::{self, Kind, Metric};
use crate::process_use::ProcessUse;
use crate::registered::registered;
use prometheus::{
    Gauge, GaugeVec, Histogram, HistogramOpts, IntCounter, IntCounterVec, IntGauge, Opts, Registry,
    TextEncoder,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// The metrics that every stage has, and those that a stage adds. All handles are made at start, so recording is a few atomic
/// operations: no lock, no allocation. Clones share the same numbers.
#[derive(Clone)]
pub struct StageMetrics {
    stage: Arc<str>,
    replica: u32,
    registry: Registry,
    latency: Histogram,
    scan_to_output: Histogram,
    handled: IntCounter,
    dropped: Vec<(&'static str, IntCounter)>,
    dropped_by_reason: IntCounterVec,
    last_sequence: IntGauge,
    waiting: IntGauge,
    heartbeat: Gauge,
    /// CLOCK_MONOTONIC of the last handled scan's capture.
    captured_ns: Arc<AtomicU64>,
    /// Values that are read only on request.
    scan_age: Gauge,
    process: ProcessUse,
}

/// Counters of one metric: one for each value of a label, in the order in which they were named.
#[derive(Clone)]
pub struct LabelledCounters(Vec<IntCounter>);

impl LabelledCounters {
    /// Counts one for the value at this place.
    pub fn count(&self, place: usize) {
        self.0[place].inc();
    }

    /// Counts so many for the value at this place.
    pub fn count_by(&self, place: usize, times: u64) {
        self.0[place].inc_by(times);
    }
}

/// Counters of one metric by labels whose values are not known beforehand. Counting looks the labels up under a lock: nothing for
/// what happens with every scan.
#[derive(Clone)]
pub struct CountersByLabels(IntCounterVec);

impl CountersByLabels {
    /// Counts so many for these values, in the order of the labels.
    pub fn count_by(&self, values: &[&str], times: u64) {
        self.0.with_label_values(values).inc_by(times);
    }

    /// The counter of these values: for what happens often.
    pub fn one(&self, values: &[&str]) -> IntCounter {
        self.0.with_label_values(values)
    }
}

/// Gauges of one metric by labels whose values are not known beforehand.
#[derive(Clone)]
pub struct GaugesByLabels(GaugeVec);

impl GaugesByLabels {
    /// The gauge of these values, in the order of the labels.
    pub fn one(&self, values: &[&str]) -> Gauge {
        self.0.with_label_values(values)
    }

    /// Removes the gauge of these values, where there is one.
    pub fn remove(&self, values: &[&str]) {
        let _ = self.0.remove_label_values(values);
    }
}

impl StageMetrics {
    /// Metrics of one replica of a stage; `reasons` are the drop reasons that are known beforehand (they appear with
    /// a count of 0 from the start).
    pub fn new(stage_name: &str, replica: u32, reasons: &[&'static str]) -> Self {
        let registry = Registry::new();
        let opts = |metric| labelled(metric, stage_name, replica);
        let dropped_by_reason =
            registered(&registry, IntCounterVec::new(opts(names::DROPPED), &[names::LABEL_REASON]));
        let metrics = Self {
            stage: stage_name.into(),
            replica,
            latency: histogram(&registry, opts(names::STAGE_LATENCY), names::STAGE_LATENCY),
            scan_to_output: histogram(&registry, opts(names::SCAN_TO_OUTPUT), names::SCAN_TO_OUTPUT),
            handled: registered(&registry, IntCounter::with_opts(opts(names::SCANS_HANDLED))),
            last_sequence: registered(&registry, IntGauge::with_opts(opts(names::LAST_SCAN_SEQUENCE))),
            waiting: registered(&registry, IntGauge::with_opts(opts(names::WAITING_SCANS))),
            heartbeat: registered(&registry, Gauge::with_opts(opts(names::HEARTBEAT))),
            dropped: reasons.iter().map(|&r| (r, dropped_by_reason.with_label_values(&[r]))).collect(),
            dropped_by_reason,
            captured_ns: Arc::new(AtomicU64::new(monotonic_ns())),
            scan_age: registered(&registry, Gauge::with_opts(opts(names::LAST_SCAN_AGE))),
            process: ProcessUse::new(&registry, &opts),
            registry,
        };
        let id = registered(&metrics.registry, IntGauge::with_opts(opts(names::PROCESS_ID)));
        id.set(i64::from(std::process::id()));
        metrics
    }

    /// A counter of the stage's own; to be made once, at start.
    pub fn counter(&self, metric: Metric) -> IntCounter {
        registered(&self.registry, IntCounter::with_opts(self.opts(metric)))
    }

    /// A gauge of the stage's own; to be made once, at start.
    pub fn gauge(&self, metric: Metric) -> Gauge {
        registered(&self.registry, Gauge::with_opts(self.opts(metric)))
    }

    /// A histogram of the stage's own; to be made once, at start.
    pub fn histogram(&self, metric: Metric) -> Histogram {
        histogram(&self.registry, self.opts(metric), metric)
    }

    /// Counters of the stage's own, one for each of these values of `label`; to be made once, at start.
    pub fn counters(&self, metric: Metric, label: &str, values: &[&'static str]) -> LabelledCounters {
        let counters = registered(&self.registry, IntCounterVec::new(self.opts(metric), &[label]));
        LabelledCounters(values.iter().map(|value| counters.with_label_values(&[value])).collect())
    }

    /// Counters of the stage's own by labels whose values come later; to be made once, at start.
    pub fn counters_by(&self, metric: Metric, labels: &[&str]) -> CountersByLabels {
        CountersByLabels(registered(&self.registry, IntCounterVec::new(self.opts(metric), labels)))
    }

    /// Gauges of the stage's own by labels whose values come later; to be made once, at start.
    pub fn gauges_by(&self, metric: Metric, labels: &[&str]) -> GaugesByLabels {
        GaugesByLabels(registered(&self.registry, GaugeVec::new(self.opts(metric), labels)))
    }

    fn opts(&self, metric: Metric) -> Opts {
        labelled(metric, &self.stage, self.replica)
    }

    /// Records a handled scan: its sequence number, the time in the stage's logic, and the time from the scan's
    /// capture to the stage's output, both in nanoseconds.
    pub fn handled(&self, sequence: u64, latency_ns: u64, scan_to_output_ns: u64) {
        self.latency.observe(seconds(latency_ns));
        self.scan_to_output.observe(seconds(scan_to_output_ns));
        self.handled.inc();
        self.last_sequence.set(i64::try_from(sequence).unwrap_or(i64::MAX));
    }

    /// Counts a drop. A reason that was not named at the start costs a lock the first and every other time.
    pub fn dropped(&self, reason: &str) {
        match self.dropped.iter().find(|(known, _)| *known == reason) {
            Some((_, counter)) => counter.inc(),
            None => self.dropped_by_reason.with_label_values(&[reason]).inc(),
        }
    }

    /// Notes when the last handled scan was taken, CLOCK_MONOTONIC nanoseconds.
    pub fn captured(&self, captured_ns: u64) {
        self.captured_ns.store(captured_ns, Ordering::Relaxed);
    }

    /// Notes how many scans the stage holds and has not handled.
    pub fn waiting(&self, scans: usize) {
        self.waiting.set(scans as i64);
    }

    /// Notes a sign of life at this CLOCK_MONOTONIC time, nanoseconds.
    pub fn alive(&self, now_ns: u64) {
        self.heartbeat.set(seconds(now_ns));
    }

    /// Scans handled so far.
    pub fn handled_count(&self) -> u64 {
        self.handled.get()
    }

    /// All metrics in the Prometheus text format.
    pub fn render(&self) -> String {
        let age_ns = monotonic_ns().saturating_sub(self.captured_ns.load(Ordering::Relaxed));
        self.scan_age.set(seconds(age_ns));
        self.process.look();
        TextEncoder::new()
            .encode_to_string(&self.registry.gather())
            .expect("metrics with constant names can always be written")
    }
}

/// The stage's labels are constant ones; a metric that repeated one of them as a variable label would come out with
/// the label twice, which is not valid.
fn labelled(metric: Metric, stage_name: &str, replica: u32) -> Opts {
    Opts::new(metric.name, metric.help)
        .const_label(names::LABEL_STAGE, stage_name)
        .const_label(names::LABEL_REPLICA, replica.to_string())
}

fn histogram(registry: &Registry, opts: Opts, metric: Metric) -> Histogram {
    let Kind::Histogram(bounds) = metric.kind else { panic!("{} is no histogram", metric.name) };
    registered(registry, Histogram::with_opts(HistogramOpts::from(opts).buckets(bounds.to_vec())))
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_has_each_metric_with_the_stage_labels_once() {
        let metrics = StageMetrics::new("mapper", 1, &["deadline", "overload"]);
        metrics.handled(41, 30_000, 300_000);
        metrics.dropped("deadline");
        metrics.dropped("a new reason");
        metrics.alive(2_500_000_000);
        metrics.waiting(3);
        let kept = metrics.counters(names::KEPT, names::LABEL_REASON, &["novel", "travel"]);
        kept.count(1);
        let text = metrics.render();
        for line in [
            r#"flockslam_dropped_total{reason="deadline",replica="1",stage="mapper"} 1"#,
            r#"flockslam_dropped_total{reason="overload",replica="1",stage="mapper"} 0"#,
            r#"flockslam_dropped_total{reason="a new reason",replica="1",stage="mapper"} 1"#,
            r#"flockslam_kept_total{reason="novel",replica="1",stage="mapper"} 0"#,
            r#"flockslam_kept_total{reason="travel",replica="1",stage="mapper"} 1"#,
            r#"flockslam_last_scan_sequence{replica="1",stage="mapper"} 41"#,
            r#"flockslam_heartbeat_monotonic_seconds{replica="1",stage="mapper"} 2.5"#,
            r#"flockslam_scans_handled_total{replica="1",stage="mapper"} 1"#,
            r#"flockslam_waiting_scans{replica="1",stage="mapper"} 3"#,
        ] {
            assert!(text.lines().any(|l| l == line), "{line} is missing in\n{text}");
        }
        assert!(text.lines().any(|l| l.starts_with("flockslam_stage_latency_seconds_bucket{")
            && l.contains(r#"le="0.00005""#)
            && l.ends_with(" 1")));
        assert!(text.lines().filter(|l| l.starts_with('f')).all(|l| l.matches("stage=").count() == 1));
    }

    #[test]
    fn every_recorded_scan_is_counted_once() {
        let metrics = StageMetrics::new("mapper", 0, &["deadline"]);
        let scans = 200_000;
        for sequence in 0..scans {
            metrics.handled(sequence, 30_000 + sequence, 300_000);
            metrics.dropped("deadline");
        }
        assert_eq!((metrics.handled_count(), metrics.dropped[0].1.get()), (scans, scans));
        assert_eq!(metrics.latency.get_sample_count(), scans);
        assert_eq!(metrics.scan_to_output.get_sample_count(), scans);
        assert!((metrics.scan_to_output.get_sample_sum() - 60.0).abs() < 1e-6);
        assert_eq!(metrics.last_sequence.get(), 199_999);
    }
}
