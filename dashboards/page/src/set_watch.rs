//! The thread that asks the supervisor how the set is and reads the latencies of its stages.

use crate::health::{Health, events_between};
use crate::shared_view::{Place, Shared};
use crate::stage_latency::{LatencySample, LatencyWatch, StageLatency};
use flockslam_stage::metrics_socket;
use flockslam_telemetry::scrape;
use std::collections::BTreeMap;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// How often the supervisor is queried while a browser shows the page.
const PERIOD: Duration = Duration::from_millis(250);
/// The same while none does. Latencies are read at this period, too.
const PERIOD_IDLE: Duration = Duration::from_secs(1);
/// A stage that does not give its metrics within this is passed over.
const SCRAPE_LIMIT: Duration = Duration::from_millis(200);

/// Watches how the stages are, until the set ends.
pub fn watch_set(place: &Place, shared: &Shared) {
    let status_dir = place.set_dir.join("status");
    let (mut last, mut scraped): (Health, Option<Instant>) = (Health::default(), None);
    let mut latencies = LatencyWatch::default();
    while !shared.has_ended() {
        let began = Instant::now();
        let health = shared.access.health();
        match &health {
            Ok(health) => {
                let events = events_between(&last, health, shared.now_ms());
                events.into_iter().for_each(|event| shared.view().events.push(event));
                last.clone_from(health);
            }
            Err(_) if !shared.access.is_alive() => shared.end(),
            Err(error) => tracing::debug!(error, "the supervisor does not answer"),
        }
        shared.view().health.set(health.ok());
        if scraped.is_none_or(|at| at.elapsed() >= PERIOD_IDLE) {
            let seconds = scraped.map_or(0.0, |at| at.elapsed().as_secs_f64());
            scraped = Some(Instant::now());
            let sample = LatencySample {
                stages: read_latencies(&status_dir, &last, &mut latencies, seconds),
                at_ms: shared.now_ms(),
            };
            shared.view().latencies.push(sample);
        }
        let period = if shared.viewers() > 0 { PERIOD } else { PERIOD_IDLE };
        thread::sleep(period.saturating_sub(began.elapsed()));
    }
}

fn read_latencies(
    status_dir: &Path,
    health: &Health,
    watch: &mut LatencyWatch,
    seconds: f64,
) -> BTreeMap<String, StageLatency> {
    let mut latencies: BTreeMap<String, StageLatency> = BTreeMap::new();
    for stage in health.stages.iter().filter(|stage| stage.pid.is_some()) {
        let process = format!("{}-{}", stage.stage, stage.replica);
        let Ok(page) = scrape(&metrics_socket(status_dir, &process), SCRAPE_LIMIT) else { continue };
        // Of several processes the one that handles most is shown.
        if let Some(latency) = watch.look(&process, &page, seconds)
            && latencies.get(&stage.stage).is_none_or(|other| other.rate_hz < latency.rate_hz)
        {
            latencies.insert(stage.stage.clone(), latency);
        }
    }
    latencies
}
