//! Tracing set-up, metric names, the metrics endpoint, heartbeats.
