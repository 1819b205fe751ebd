//! Latencies of a stage between two readings of its metrics page: quantiles of the difference of two histograms.

use flockslam_telemetry::{bucket_quantile, names};
use serde::Serialize;
use std::collections::BTreeMap;

/// A cumulative histogram as Prometheus' text format has it: seconds → observations up to there.
type Buckets = Vec<(f64, u64)>;

/// How long a stage took for the scans between two looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StageLatency {
    /// Scans a second.
    pub rate_hz: f64,
    /// Median of the time in the stage's own logic, milliseconds.
    pub p50_ms: f64,
    /// 99th percentile of it.
    pub p99_ms: f64,
    /// Median of the time from the capture of a scan to the stage's output for it, milliseconds.
    pub since_scan_p50_ms: f64,
    /// 99th percentile of it.
    pub since_scan_p99_ms: f64,
}

/// The stages' latencies between two looks; a stage that handled nothing is not in it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LatencySample {
    /// When, milliseconds since the page began.
    pub at_ms: u64,
    /// By stage.
    pub stages: BTreeMap<String, StageLatency>,
}

/// What the last look has seen, by process.
#[derive(Debug, Default)]
pub struct LatencyWatch {
    seen: BTreeMap<String, (Buckets, Buckets)>,
}

impl LatencyWatch {
    /// Takes in the page of metrics of a process of a stage; what it did in the `seconds` since the last one. Nothing at the first look.
    pub fn look(&mut self, process: &str, page: &str, seconds: f64) -> Option<StageLatency> {
        let own = buckets(page, names::STAGE_LATENCY.name);
        let since_scan = buckets(page, names::SCAN_TO_OUTPUT.name);
        let (own_before, since_before) =
            self.seen.insert(process.to_owned(), (own.clone(), since_scan.clone()))?;
        let own = between(&own_before, &own);
        let since_scan = between(&since_before, &since_scan);
        let handled = own.last().map_or(0, |(_, count)| *count);
        (handled > 0).then(|| StageLatency {
            rate_hz: handled as f64 / seconds,
            p50_ms: 1e3 * quantile(&own, 0.5),
            p99_ms: 1e3 * quantile(&own, 0.99),
            since_scan_p50_ms: 1e3 * quantile(&since_scan, 0.5),
            since_scan_p99_ms: 1e3 * quantile(&since_scan, 0.99),
        })
    }
}

/// The buckets of the histogram of this name in a page of one process.
fn buckets(page: &str, name: &str) -> Buckets {
    let bucket = |line: &str| {
        let labels = line.strip_prefix(name)?.strip_prefix("_bucket{")?;
        let (labels, count) = labels.rsplit_once("} ")?;
        let bound = labels.split_once("le=\"")?.1.split('"').next()?;
        let bound = if bound == "+Inf" { f64::INFINITY } else { bound.parse().ok()? };
        Some((bound, count.parse().ok()?))
    };
    page.lines().filter_map(bucket).collect()
}

/// What came in between two looks. A process that was started again began with zeros.
fn between(before: &Buckets, after: &Buckets) -> Buckets {
    let total = |buckets: &Buckets| buckets.last().map_or(0, |(_, count)| *count);
    if before.len() != after.len() || total(before) > total(after) {
        return after.clone();
    }
    after.iter().zip(before).map(|(now, then)| (now.0, now.1.saturating_sub(then.1))).collect()
}

/// The quantile of a histogram; 0 without values.
fn quantile(buckets: &Buckets, share: f64) -> f64 {
    let buckets: Vec<(f64, f64)> = buckets.iter().map(|(bound, count)| (*bound, *count as f64)).collect();
    bucket_quantile(&buckets, share).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_telemetry::StageMetrics;

    #[test]
    fn what_a_stage_did_between_two_looks_is_read_from_its_metrics() {
        let (metrics, mut watch) = (StageMetrics::new("mapper", 0, &[]), LatencyWatch::default());
        metrics.handled(1, 900_000_000, 900_000_000);
        assert_eq!(watch.look("mapper-0", &metrics.render(), 1.0), None);
        assert_eq!(watch.look("mapper-0", &metrics.render(), 1.0), None, "it did nothing");
        (0..20).for_each(|sequence| metrics.handled(sequence, 300_000, 4_000_000));
        let latency = watch.look("mapper-0", &metrics.render(), 2.0).unwrap();
        assert_eq!(latency.rate_hz, 10.0);
        // All 20 lie in one bucket: from 0.2 ms to 0.5 ms, and from 2 ms to 5 ms.
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(close(latency.p50_ms, 0.35) && close(latency.p99_ms, 0.497), "{latency:?}");
        let since_scan = (latency.since_scan_p50_ms, latency.since_scan_p99_ms);
        assert!(close(since_scan.0, 3.5) && close(since_scan.1, 4.97), "{latency:?}");
        let successor = StageMetrics::new("mapper", 0, &[]);
        successor.handled(1, 30_000, 30_000);
        let latency = watch.look("mapper-0", &successor.render(), 1.0).unwrap();
        assert!(latency.rate_hz == 1.0 && close(latency.p50_ms, 0.035), "{latency:?}");
    }
}
