//! Metrics are registered where they are made.

use prometheus::Registry;
use prometheus::core::Collector;

/// Registers a metric that was made just now. Names are constants, so this cannot fail.
pub(crate) fn registered<C: Collector + Clone + 'static>(
    registry: &Registry,
    metric: prometheus::Result<C>,
) -> C {
    let metric = metric.expect("metric names and buckets are constants");
    registry.register(Box::new(metric.clone())).expect("each metric is registered once");
    metric
}
