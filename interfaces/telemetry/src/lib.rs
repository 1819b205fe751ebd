//! What a stage tells about itself: log lines, metrics over a local socket, a heartbeat, latency records.
//!
//! Nothing here decides anything: a stage whose telemetry fails goes on with its work.

mod clock;
mod endpoint;
mod exposition;
mod heartbeat;
mod http;
mod latency;
mod logging;
pub mod names;
mod sabotage;
mod scrape;
mod stage_metrics;
mod supervisor_metrics;

pub use clock::{monotonic_ns, utc_ns};
pub use endpoint::{EndpointError, MetricsEndpoint};
pub use exposition::merge_expositions;
pub use heartbeat::{Beat, Heartbeat, HeartbeatError, read_heartbeat};
pub use latency::{LatencyHistogram, LatencyQuantiles};
pub use logging::init_tracing;
pub use sabotage::{is_sabotaged, sabotage};
pub use scrape::{ScrapeError, scrape};
pub use stage_metrics::{KeptCounters, StageMetrics};
pub use supervisor_metrics::SupervisorMetrics;
