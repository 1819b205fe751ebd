//! Telemetry of a stage: log lines, metrics over a local socket, a heartbeat, latency records.
//!
//! Nothing here decides anything: a stage whose telemetry fails goes on with its work.

mod clock;
mod counter_memory;
mod endpoint;
mod exposition;
mod failpoint;
mod heartbeat;
mod http;
mod latency;
mod logging;
mod metrics_page;
pub mod names;
mod names_of_lidars;
mod process_use;
mod quantile;
mod registered;
mod scrape;
mod stage_metrics;
mod supervisor_metrics;

pub use clock::{monotonic_ns, utc_ns};
pub use counter_memory::CounterMemory;
pub use endpoint::{EndpointError, MetricsEndpoint};
pub use exposition::merge_expositions;
pub use failpoint::{failpoint, failpoint_value};
pub use heartbeat::{Beat, Heartbeat, HeartbeatError, read_heartbeat};
pub use latency::{LatencyHistogram, LatencyQuantiles};
pub use logging::{LogLevels, check_log_filter, init_tracing, log_into_set, log_stream_file, set_log_filter};
pub use metrics_page::metrics_page;
/// Handles that [`StageMetrics`] gives out.
pub use prometheus::{Gauge, Histogram, IntCounter as Counter};
pub use quantile::bucket_quantile;
pub use scrape::{ScrapeError, scrape};
pub use stage_metrics::{CountersByLabels, GaugesByLabels, LabelledCounters, StageMetrics};
pub use supervisor_metrics::{RestartReason, SupervisorMetrics};
