//! One log event as a line of JSON, and its priority for journald.

use serde_json::{Map, Value};
use std::fmt;
use tracing::field::{Field, Visit};
use tracing::{Event, Level};

/// A log event as a value: what a JSON line and the set's stream have of it.
///
/// `utc_ns`, `level`, `stage`, `target` and `message`, and the fields of the event under their own names.
pub(super) fn json_line(stage: &str, utc_ns: i64, event: &Event<'_>) -> String {
    let mut fields = Fields(Map::new());
    let head = [
        ("utc_ns", Value::from(utc_ns)),
        ("level", event.metadata().level().as_str().into()),
        ("stage", stage.into()),
        ("target", event.metadata().target().into()),
    ];
    event.record(&mut fields);
    for (name, value) in head {
        // The process gives its own name; a field of the same name is that of another process.
        if let Some(other) = fields.0.insert(name.to_owned(), value) {
            fields.0.insert(format!("of_{name}"), other);
        }
    }
    let mut line = Value::Object(fields.0).to_string();
    line.push('\n');
    line
}

/// The priority of syslog, which journald reads at the beginning of a line.
pub(super) fn priority(level: Level) -> u8 {
    match level {
        Level::ERROR => 3,
        Level::WARN => 4,
        Level::INFO => 6,
        Level::DEBUG | Level::TRACE => 7,
    }
}

struct Fields(Map<String, Value>);

impl Fields {
    fn put(&mut self, field: &Field, value: impl Into<Value>) {
        self.0.insert(field.name().to_owned(), value.into());
    }
}

impl Visit for Fields {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.put(field, format!("{value:?}"));
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.put(field, value);
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.put(field, value);
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.put(field, value);
    }

    fn record_f64(&mut self, field: &Field, value: f64) {
        self.put(field, value);
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.put(field, value);
    }
}
