use std::fmt;
use std::io::IsTerminal;
use tracing::{Event, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{Compact, Format, FormatEvent, FormatFields, Writer};
use tracing_subscriber::registry::LookupSpan;

/// The environment variable that selects what is logged, for example `info` or `warn,flockslam_mapper=debug`.
const FILTER_VARIABLE: &str = "FLOCKSLAM_LOG";
const DEFAULT_FILTER: &str = "warn";

/// Sends log lines of this process to stderr, each led by `stage_name`; `FLOCKSLAM_LOG` selects them, default `warn`.
///
/// A filter that cannot be read falls back to the default with a warning. A second call changes nothing.
pub fn init_tracing(stage_name: &str) {
    let wanted = std::env::var(FILTER_VARIABLE).unwrap_or_default();
    let (filter, refused) = parse_filter(&wanted);
    let lines = Named { stage: stage_name.to_owned(), format: tracing_subscriber::fmt::format().compact() };
    let installed = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .event_format(lines)
        .try_init()
        .is_ok();
    if let (true, Some(problem)) = (installed, refused) {
        tracing::warn!("{FILTER_VARIABLE}={wanted} is not a filter ({problem}); logging {DEFAULT_FILTER}");
    }
}

/// The filter in `wanted` (empty: the default), or the default and what was wrong.
fn parse_filter(wanted: &str) -> (EnvFilter, Option<String>) {
    let text = if wanted.trim().is_empty() { DEFAULT_FILTER } else { wanted };
    match EnvFilter::try_new(text) {
        Ok(filter) => (filter, None),
        Err(problem) => (EnvFilter::new(DEFAULT_FILTER), Some(problem.to_string())),
    }
}

/// Compact lines led by the stage's name, so that the mixed output of a process set stays readable.
struct Named {
    stage: String,
    format: Format<Compact>,
}

impl<S, N> FormatEvent<S, N> for Named
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut to: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        write!(to, "[{}] ", self.stage)?;
        self.format.format_event(context, to, event)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_are_read_or_replaced_by_the_default() {
        assert_eq!(parse_filter("").0.to_string(), "warn");
        assert_eq!(parse_filter("info").0.to_string(), "info");
        let (filter, problem) = parse_filter("flockslam=loud");
        assert_eq!(filter.to_string(), "warn");
        assert!(problem.is_some());
    }

    #[test]
    fn a_second_call_is_harmless() {
        init_tracing("first");
        init_tracing("second");
        tracing::warn!("one line of the test");
    }
}
