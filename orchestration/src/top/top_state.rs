//! The figures that `flockslam top` shows. They follow from two successive metrics pages: rates and latencies are differences
//! between them. No I/O and no clock: the caller gives the page and the time.

use super::MetricsPage;
use flockslam_messages::Stage;
use flockslam_telemetry::{bucket_quantile, names};
use std::collections::VecDeque;

/// So many looks are kept for the sparklines.
const HISTORY: usize = 60;

/// State of a set after some readings of its metrics.
///
/// ```
/// use flockslam::top::TopState;
/// use flockslam_telemetry::names;
///
/// let page = |scans: u32| format!("{}{{stage=\"mapper\"}} {scans}\n", names::SCANS_HANDLED.name);
/// let mut state = TopState::new("r1");
/// state.look(10.0, Some(&page(50)));
/// state.look(12.0, Some(&page(70)));
/// let mapper = state.stages.iter().find(|stage| stage.name == "mapper").unwrap();
/// assert_eq!(mapper.rate_hz, 10.0);
/// assert!(state.answers);
/// ```
#[derive(Clone, Debug, Default)]
pub struct TopState {
    /// Name of the set.
    pub robot: String,
    /// Whether the last look was answered.
    pub answers: bool,
    /// The stages, in the order of a scan's way.
    pub stages: Vec<StageFigures>,
    /// The robot as a whole.
    pub figures: RobotFigures,
    last: Option<(f64, MetricsPage)>,
}

/// What is shown of a stage.
#[derive(Clone, Debug, Default)]
pub struct StageFigures {
    /// Its name.
    pub name: String,
    /// It runs and answers.
    pub up: bool,
    /// The set goes on without it.
    pub degraded: bool,
    /// Scans a second since the last look.
    pub rate_hz: f64,
    /// Median and 99th percentile from a scan's capture to the stage's output since the last look, seconds; `None` without scans.
    pub latency_s: Option<(f64, f64)>,
    /// Medians of the last looks, oldest first; `None` where there were no scans.
    pub history_s: VecDeque<Option<f64>>,
    /// Scans that it holds.
    pub waiting: f64,
    /// Drops so far, and since the last look.
    pub dropped: (f64, f64),
    /// Restarts so far.
    pub restarts: f64,
    /// Replacements because it hung.
    pub hangs: f64,
    /// Share of a core since the last look.
    pub cpu: f64,
    /// Memory of its own, bytes.
    pub memory_bytes: f64,
    /// Seconds since its last sign of life.
    pub silent_s: f64,
}

/// What is shown of the robot.
#[derive(Clone, Debug, Default)]
pub struct RobotFigures {
    /// Poses since the last look that are tracking, degraded and lost.
    pub qualities: [f64; 3],
    /// Mean matching score since the last look; `None` without matches.
    pub score: Option<f64>,
    /// Loop closures tried, accepted, revoked.
    pub closures: [f64; 3],
    /// Closed submaps.
    pub submaps: f64,
    /// Known area, m².
    pub area_m2: f64,
    /// Shared memory of the set, bytes.
    pub shared_memory_bytes: f64,
    /// The map cannot be saved.
    pub not_durable: bool,
}

impl TopState {
    /// Nothing is known yet.
    pub fn new(robot: &str) -> Self {
        Self { robot: robot.to_owned(), ..Self::default() }
    }

    /// Takes in a reading at `now_s` (any clock that does not jump, seconds): the page, or `None` without an answer.
    pub fn look(&mut self, now_s: f64, page: Option<&str>) {
        self.answers = page.is_some();
        let Some(page) = page.map(MetricsPage::parse) else { return };
        let empty = MetricsPage::default();
        let (span_s, before) = match &self.last {
            Some((at_s, before)) => ((now_s - at_s).max(1e-3), before),
            // What was counted before the first look has no rate.
            None => (f64::INFINITY, &empty),
        };
        let mut stages = Vec::new();
        for stage in Stage::ALL.into_iter().rev() {
            let known = self.stages.iter_mut().find(|known| known.name == stage.name());
            let history_s = known.map(|known| std::mem::take(&mut known.history_s)).unwrap_or_default();
            stages.push(Look { page: &page, before, span_s }.stage(stage.name(), history_s));
        }
        self.figures = Look { page: &page, before, span_s }.robot();
        self.stages = stages;
        self.last = Some((now_s, page));
    }
}

/// Two pages, and the time between them.
struct Look<'a> {
    page: &'a MetricsPage,
    before: &'a MetricsPage,
    span_s: f64,
}

impl Look<'_> {
    fn grown(&self, name: &str, labels: &[(&str, &str)]) -> f64 {
        if self.span_s.is_infinite() {
            return 0.0;
        }
        (self.page.sum(name, labels) - self.before.sum(name, labels)).max(0.0)
    }

    fn stage(&self, name: &str, mut history_s: VecDeque<Option<f64>>) -> StageFigures {
        let labels = [(names::LABEL_STAGE, name)];
        let sum = |metric: names::Metric| self.page.sum(metric.name, &labels);
        let latency_s = self.latency(&labels);
        history_s.push_back(latency_s.map(|(median, _)| median));
        while history_s.len() > HISTORY {
            history_s.pop_front();
        }
        let silent = self.page.find(names::HEARTBEAT_AGE.name, &labels);
        StageFigures {
            name: name.to_owned(),
            up: sum(names::STAGE_UP) > 0.0,
            degraded: sum(names::STAGE_DEGRADED) > 0.0,
            rate_hz: self.grown(names::SCANS_HANDLED.name, &labels) / self.span_s,
            latency_s,
            history_s,
            waiting: sum(names::WAITING_SCANS),
            dropped: (sum(names::DROPPED), self.grown(names::DROPPED.name, &labels)),
            restarts: sum(names::STAGE_RESTARTS),
            hangs: sum(names::STAGE_HANGS),
            cpu: self.grown(names::CPU.name, &labels) / self.span_s,
            memory_bytes: sum(names::PRIVATE_MEMORY),
            silent_s: silent.map(|sample| sample.value).fold(0.0, f64::max),
        }
    }

    /// Median and 99th percentile since the last look (since the start at the first).
    fn latency(&self, labels: &[(&str, &str)]) -> Option<(f64, f64)> {
        let name = names::SCAN_TO_OUTPUT.name;
        let before = self.before.buckets(name, labels);
        let earlier = |bound: f64| before.iter().find(|(b, _)| *b == bound).map_or(0.0, |(_, count)| *count);
        let buckets: Vec<(f64, f64)> = self
            .page
            .buckets(name, labels)
            .into_iter()
            .map(|(bound, count)| (bound, (count - earlier(bound)).max(0.0)))
            .collect();
        Some((bucket_quantile(&buckets, 0.5)?, bucket_quantile(&buckets, 0.99)?))
    }

    fn robot(&self) -> RobotFigures {
        let quality = |quality| self.grown(names::POSES.name, &[(names::LABEL_QUALITY, quality)]);
        let part = |ending| format!("{}{ending}", names::MATCH_SCORE.name);
        let matched = self.grown(&part("_count"), &[]);
        let sum = |metric: names::Metric| self.page.sum(metric.name, &[]);
        RobotFigures {
            qualities: ["tracking", "degraded", "lost"].map(quality),
            score: (matched > 0.0).then(|| self.grown(&part("_sum"), &[]) / matched),
            closures: [names::CLOSURE_SEARCHES, names::CLOSURES_ACCEPTED, names::CLOSURES_REVOKED].map(sum),
            submaps: sum(names::SUBMAPS),
            area_m2: sum(names::MAP_AREA),
            shared_memory_bytes: sum(names::SHARED_MEMORY),
            not_durable: sum(names::NOT_DURABLE) > 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_telemetry::{StageMetrics, SupervisorMetrics, merge_expositions};

    fn page(matcher: &StageMetrics, supervisor: &SupervisorMetrics) -> String {
        let pages = [matcher.render(), supervisor.render()];
        merge_expositions(pages.iter().map(String::as_str))
    }

    #[test]
    fn rates_and_latencies_are_those_since_the_last_look() {
        let (matcher, supervisor) = (
            StageMetrics::new("scan-matcher", 0, &["lost"]),
            SupervisorMetrics::new(&["scan-matcher", "mapper"]),
        );
        supervisor.set_up("scan-matcher", true);
        (0..50).for_each(|k| matcher.handled(k, 1000, 900_000_000));
        let mut state = TopState::new("r1");
        state.look(10.0, Some(&page(&matcher, &supervisor)));
        let of = |state: &TopState| {
            state.stages.iter().find(|stage| stage.name == "scan-matcher").unwrap().clone()
        };
        assert_eq!(of(&state).rate_hz, 0.0);
        (0..100).for_each(|k| matcher.handled(50 + k, 1000, 300_000));
        matcher.dropped("lost");
        state.look(12.0, Some(&page(&matcher, &supervisor)));
        let stage = of(&state);
        assert_eq!((stage.rate_hz, stage.dropped, stage.up), (50.0, (1.0, 1.0), true));
        let (median_s, p99_s) = stage.latency_s.unwrap();
        // All 100 lie in the bucket from 200 µs to 500 µs.
        assert!((median_s - 350e-6).abs() < 1e-9 && (p99_s - 497e-6).abs() < 1e-9, "{median_s} {p99_s}");
        assert_eq!(stage.history_s.len(), 2);
        assert!(!state.stages.iter().any(|stage| stage.name == "mapper" && stage.up));
        state.look(13.0, None);
        assert!(!state.answers && state.stages.len() == Stage::ALL.len());
    }
}
