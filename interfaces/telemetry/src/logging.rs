//! Log lines: to the standard error as text, JSON or for journald, and into the stream of the set. The filter can be changed
//! while the process runs.

use std::fmt;
use std::io::IsTerminal;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use tracing::{Event, Subscriber};
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{Compact, Format, FormatEvent, FormatFields, Writer};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Registry, reload};

mod log_levels;
mod log_line;
mod stream;

use crate::clock::log_time_ns;
pub use log_levels::LogLevels;
use stream::StreamLayer;
pub use stream::log_stream_file;

/// The environment variable that selects what is logged, for example `info` or `warn,flockslam_mapper=debug`.
const FILTER_VARIABLE: &str = "FLOCKSLAM_LOG";
/// What the libraries of the ROS graph warn of is their daily business.
const DEFAULT_FILTER: &str = "warn,rustdds=error,ros2_client=error";
/// The environment variable that selects how lines look: `text`, `json` or `journal`.
const FORMAT_VARIABLE: &str = "FLOCKSLAM_LOG_FORMAT";

/// What of the logging can be changed while the process runs.
struct Control {
    filter: reload::Handle<EnvFilter, Registry>,
    /// What holds when nothing else is asked for.
    initial: String,
    stream: Arc<OnceLock<PathBuf>>,
}

static CONTROL: OnceLock<Control> = OnceLock::new();

/// Sends log lines of this process to stderr, each led by `stage_name`; `FLOCKSLAM_LOG` selects them, default `warn`, and
/// `FLOCKSLAM_LOG_FORMAT` how they look: `text`, `json` (one object a line) or `journal` (led by `<priority>`, without the time,
/// as journald has it; the default where it is the one that reads).
///
/// A filter or format that cannot be read falls back to the default with a warning. A second call changes nothing.
pub fn init_tracing(stage_name: &str) {
    let wanted = std::env::var(FILTER_VARIABLE).unwrap_or_default();
    let (filter, refused) = parse_filter(&wanted);
    let format = std::env::var(FORMAT_VARIABLE).ok();
    let (look, unknown) = Look::wanted(format.as_deref(), journal_reads());
    let initial = filter.to_string();
    let (filter, handle) = reload::Layer::new(filter);
    let path = Arc::new(OnceLock::new());
    let lines =
        Named { stage: stage_name.to_owned(), look, format: tracing_subscriber::fmt::format().compact() };
    let to_stderr = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(look == Look::Text && std::io::stderr().is_terminal())
        .event_format(lines);
    let stream = StreamLayer { stage: stage_name.to_owned(), path: Arc::clone(&path) };
    let layers = tracing_subscriber::registry().with(filter).with(to_stderr).with(stream);
    if layers.try_init().is_err() {
        return;
    }
    let _ = CONTROL.set(Control { filter: handle, initial, stream: path });
    if let Some(problem) = refused {
        tracing::warn!("{FILTER_VARIABLE}={wanted} is not a filter ({problem}); logging {DEFAULT_FILTER}");
    }
    if let Some(unknown) = unknown {
        tracing::warn!("{FORMAT_VARIABLE}={unknown} is none of text, json, journal");
    }
}

/// From now on all lines of this process also go into the stream of the set whose directory is `runtime`.
pub fn log_into_set(runtime: &Path) {
    if let Some(control) = CONTROL.get() {
        let _ = control.stream.set(log_stream_file(runtime));
    }
}

/// Changes what this process logs; an empty filter brings back what it began with.
///
/// # Errors
/// When it is not a filter: why.
pub fn set_log_filter(filter: &str) -> Result<(), String> {
    let Some(control) = CONTROL.get() else { return Ok(()) };
    let filter = if filter.is_empty() { control.initial.as_str() } else { filter };
    let filter = EnvFilter::try_new(filter).map_err(|problem| problem.to_string())?;
    control.filter.reload(filter).map_err(|problem| problem.to_string())
}

/// Whether a filter can be read.
///
/// # Errors
/// When it cannot: why.
pub fn check_log_filter(filter: &str) -> Result<(), String> {
    parse_filter(filter).1.map_or(Ok(()), Err)
}

/// The filter in `wanted` (empty: the default), or the default and what was wrong.
fn parse_filter(wanted: &str) -> (EnvFilter, Option<String>) {
    let text = if wanted.trim().is_empty() { DEFAULT_FILTER } else { wanted };
    match EnvFilter::try_new(text) {
        Ok(filter) => (filter, None),
        Err(problem) => (EnvFilter::new(DEFAULT_FILTER), Some(problem.to_string())),
    }
}

/// How lines look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Look {
    Text,
    Json,
    Journal,
}

impl Look {
    /// The one that is wanted by name, or else the one for who reads; and a name that is not known.
    fn wanted(name: Option<&str>, journal_reads: bool) -> (Self, Option<&str>) {
        let usual = if journal_reads { Self::Journal } else { Self::Text };
        match name {
            None | Some("") => (usual, None),
            Some("text") => (Self::Text, None),
            Some("json") => (Self::Json, None),
            Some("journal") => (Self::Journal, None),
            unknown => (usual, unknown),
        }
    }
}

/// Whether the standard error leads to journald, which says so by device and inode of its socket.
fn journal_reads() -> bool {
    let Ok(text) = std::env::var("JOURNAL_STREAM") else { return false };
    std::fs::metadata("/proc/self/fd/2")
        .is_ok_and(|stderr| text == format!("{}:{}", stderr.dev(), stderr.ino()))
}

/// Lines with the stage's name, so that the mixed output of a process set stays readable.
struct Named {
    stage: String,
    look: Look,
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
        match self.look {
            Look::Json => write!(to, "{}", log_line::json_line(&self.stage, log_time_ns(), event)),
            Look::Journal => {
                let metadata = event.metadata();
                write!(
                    to,
                    "<{}>[{}] {}: ",
                    log_line::priority(*metadata.level()),
                    self.stage,
                    metadata.target()
                )?;
                context.field_format().format_fields(to.by_ref(), event)?;
                writeln!(to)
            }
            Look::Text => {
                write!(to, "[{}] ", self.stage)?;
                self.format.format_event(context, to, event)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn filters_are_read_or_replaced_by_the_default() {
        let default = parse_filter(DEFAULT_FILTER).0.to_string();
        assert_eq!(parse_filter("").0.to_string(), default);
        assert_eq!(parse_filter("info").0.to_string(), "info");
        let (filter, problem) = parse_filter("flockslam=loud");
        assert_eq!(filter.to_string(), default);
        assert!(problem.is_some() && check_log_filter("flockslam=loud").is_err());
        assert_eq!(check_log_filter("debug"), Ok(()));
    }

    #[test]
    fn lines_look_as_wanted_or_as_the_reader_has_them() {
        assert_eq!(Look::wanted(None, false), (Look::Text, None));
        assert_eq!(Look::wanted(None, true), (Look::Journal, None));
        assert_eq!(Look::wanted(Some("json"), true), (Look::Json, None));
        assert_eq!(Look::wanted(Some("xml"), false), (Look::Text, Some("xml")));
    }

    #[test]
    fn lines_go_into_the_stream_of_the_set_and_levels_change_meanwhile() {
        let directory = tempfile::tempdir().unwrap();
        init_tracing("first");
        init_tracing("second");
        log_into_set(directory.path());
        let mut levels = LogLevels::of(directory.path(), "first");
        tracing::warn!(scan = 41, score = 0.5, of = "x", stage = "mapper", "one line of the test");
        tracing::debug!("not yet");
        levels.look(0);
        LogLevels::set(directory.path(), "first", "debug").unwrap();
        levels.look(1);
        tracing::debug!("too soon");
        levels.look(1_000_000_000);
        tracing::debug!(scan = 42, "now");
        let stream = std::fs::read_to_string(log_stream_file(directory.path())).unwrap();
        let lines: Vec<Value> = stream.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        // Other tests of this process may log as well.
        let ours = |message: &str| lines.iter().find(|line| line["message"] == message);
        let line = ours("one line of the test").unwrap();
        for (field, value) in [
            ("scan", Value::from(41)),
            ("score", 0.5.into()),
            ("stage", "first".into()),
            ("of_stage", "mapper".into()),
        ] {
            assert_eq!(line[field], value, "{line}");
        }
        assert_eq!(line["level"], "WARN");
        assert!(
            line["utc_ns"].as_i64().unwrap() > 0 && ours("not yet").is_none() && ours("too soon").is_none()
        );
        assert_eq!(ours("now").unwrap()["scan"], 42);
    }
}
