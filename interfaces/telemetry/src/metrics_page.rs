//! The documentation page of all metrics, made from their definitions.

use crate::names::{self, Kind, Metric};
use std::fmt::Write;

/// `docs/metrics.md`: every metric, made from [`names::ALL`].
pub fn metrics_page() -> String {
    let mut page = String::from(
        "# Metrics\n\n\
         Made from `interfaces/telemetry/src/names.rs`; a test says when it is out of date and how to make it anew.\n\n\
         `flockslam map`, `demo` and `up` serve all of these as one Prometheus page: with `--metrics-port PORT` (for `up`: `metrics_port` in\n\
         the set's description) at `http://127.0.0.1:PORT/metrics`, and always on the socket `status/supervisor.metrics` in the set's directory.\n\
         Each process also answers by itself, on `status/STAGE-REPLICA.metrics`.\n\n\
         Counters and histograms go on across restarts of a stage: the supervisor adds what earlier processes of it have counted. It looks once\n\
         a second while a port is served, so what a killed process counted after the last look is missing.\n",
    );
    let mut source = "";
    for metric in &names::ALL {
        if metric.source != source {
            source = metric.source;
            write_heading(&mut page, source);
        }
        write_row(&mut page, metric);
    }
    write_buckets(&mut page);
    page
}

fn write_heading(page: &mut String, source: &str) {
    let mut letters = source.chars();
    let first = letters.next().map(|letter| letter.to_ascii_uppercase());
    let title: String = first.into_iter().chain(letters).collect();
    writeln!(page, "\n## {title}\n\n| metric | kind | labels | meaning |\n|---|---|---|---|")
        .expect("a string takes any text");
}

fn write_row(page: &mut String, metric: &Metric) {
    let Metric { name, kind, labels, help, .. } = metric;
    writeln!(page, "| `{name}` | {} | {} | {help} |", kind.name(), labels.join(", "))
        .expect("a string takes any text");
}

fn write_buckets(page: &mut String) {
    page.push_str("\n## Buckets of histograms\n\n| metric | upper bounds |\n|---|---|\n");
    for metric in &names::ALL {
        if let Kind::Histogram(bounds) = metric.kind {
            let bounds: Vec<_> = bounds.iter().map(f64::to_string).collect();
            writeln!(page, "| `{}` | {} |", metric.name, bounds.join(", ")).expect("a string takes any text");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_page_in_docs_is_up_to_date() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/metrics.md");
        if std::env::var_os("FLOCKSLAM_WRITE_DOCS").is_some() {
            std::fs::write(&file, metrics_page()).unwrap();
        }
        let found = std::fs::read_to_string(&file).unwrap_or_default();
        assert!(
            found == metrics_page(),
            "docs/metrics.md is out of date: FLOCKSLAM_WRITE_DOCS=1 cargo test -p flockslam-telemetry metrics_page"
        );
    }
}
