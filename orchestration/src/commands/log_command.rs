//! `flockslam log`: what the processes of a running set have logged, and what they shall log.

use super::control_command::{choose, order};
use super::{CommandError, print};
use crate::arguments::LogArgs;
use crate::supervisor::Request;
use flockslam_bus::RuntimeDir;
use flockslam_telemetry::log_stream_file;
use serde_json::{Map, Value};
use std::fmt::Write;

/// Fields that stand at the head of a line.
const HEAD: [&str; 5] = ["utc_ns", "level", "stage", "target", "message"];

/// Changes levels, or prints the stream.
///
/// # Errors
/// When there is no such set, or it refuses.
pub fn run(args: &LogArgs) -> Result<(), CommandError> {
    let robot = choose(&args.robot)?;
    for (stage, filter) in &args.levels {
        order(&robot, &Request::Log(stage.clone(), filter.clone()))?;
    }
    if args.levels.is_empty() {
        let file = log_stream_file(&RuntimeDir::path_of(&robot));
        // Nothing has been logged as long as it is not there.
        let stream = std::fs::read_to_string(&file).unwrap_or_default();
        print(&if args.json { stream } else { stream.lines().map(for_people).collect() });
    }
    Ok(())
}

/// A line of the stream as it is read best; what is not one stays as it is.
fn for_people(line: &str) -> String {
    let Ok(Value::Object(fields)) = serde_json::from_str::<Value>(line) else { return format!("{line}\n") };
    let text = |name: &str| fields.get(name).map(plain).unwrap_or_default();
    let ms_of_day = fields
        .get("utc_ns")
        .and_then(Value::as_i64)
        .unwrap_or(0)
        .div_euclid(1_000_000)
        .rem_euclid(86_400_000);
    let mut shown = format!(
        "{:02}:{:02}:{:02}.{:03} {:<5} {:<18} {}",
        ms_of_day / 3_600_000,
        ms_of_day / 60_000 % 60,
        ms_of_day / 1000 % 60,
        ms_of_day % 1000,
        text("level"),
        text("stage"),
        text("message")
    );
    write_fields(&mut shown, &fields);
    shown.push('\n');
    shown
}

fn write_fields(to: &mut String, fields: &Map<String, Value>) {
    for (name, value) in fields.iter().filter(|(name, _)| !HEAD.contains(&name.as_str())) {
        write!(to, " {name}={}", plain(value)).expect("a string takes any text");
    }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_shown_with_its_time_and_fields() {
        let line = r#"{"level":"DEBUG","message":"matched","scan":41,"score":0.5,"stage":"scan-matcher","target":"m","utc_ns":3723004000000}"#;
        assert_eq!(for_people(line), "01:02:03.004 DEBUG scan-matcher       matched scan=41 score=0.5\n");
        assert_eq!(for_people("torn"), "torn\n");
    }
}
