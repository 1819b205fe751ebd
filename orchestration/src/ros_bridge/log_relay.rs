//! Follows the log of a set: its lines as messages of `/rosout`.

use flockslam_ros::messages::{Log, Time};
use flockslam_telemetry::log_stream_file;
use serde_json::{Map, Value};
use std::fs::File;
use std::io::{BufRead, BufReader, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Lines that are handed on at a time at most: a flood of them stays in the log of the set.
const LINES_MAX: usize = 100;
/// Fields that are no part of the text.
const HEAD: [&str; 5] = ["utc_ns", "level", "stage", "target", "message"];

/// The log of a set, from now on.
pub struct LogRelay {
    path: PathBuf,
    /// Name of the node, before that of the stage.
    node: String,
    file: Option<BufReader<File>>,
}

impl LogRelay {
    /// Follows the log of the set in `set_dir`; what it has said before is not handed on.
    pub fn at_the_end(set_dir: &Path, node: &str) -> Self {
        let path = log_stream_file(set_dir);
        let file = File::open(&path).ok().map(|mut file| {
            let _ = file.seek(SeekFrom::End(0));
            BufReader::new(file)
        });
        Self { path, node: node.to_owned(), file }
    }

    /// Lines since the last look.
    pub fn read(&mut self) -> Vec<Log> {
        let mut found = self.rest();
        let inode = |file: &BufReader<File>| file.get_ref().metadata().map(|metadata| metadata.ino()).ok();
        let now = std::fs::metadata(&self.path).map(|metadata| metadata.ino()).ok();
        if now.is_some() && now != self.file.as_ref().and_then(inode) {
            // The stream has begun anew.
            self.file = File::open(&self.path).ok().map(BufReader::new);
            found.extend(self.rest());
        }
        found
    }

    fn rest(&mut self) -> Vec<Log> {
        let Some(file) = &mut self.file else { return Vec::new() };
        let (mut found, mut line) = (Vec::new(), String::new());
        // Lines are written in one piece.
        while file.read_line(&mut line).is_ok_and(|length| length > 0) {
            if found.len() < LINES_MAX {
                found.extend(message(&self.node, &line));
            }
            line.clear();
        }
        found
    }
}

fn message(node: &str, line: &str) -> Option<Log> {
    let fields: Map<String, Value> = serde_json::from_str(line).ok()?;
    let plain = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let text = |name: &str| fields.get(name).map(plain).unwrap_or_default();
    let rest = fields.iter().filter(|(name, _)| !HEAD.contains(&name.as_str()));
    let rest: String = rest.map(|(name, value)| format!(" {name}={}", plain(value))).collect();
    Some(Log {
        stamp: Time::from_ns(fields.get("utc_ns").and_then(Value::as_i64)?),
        level: match text("level").as_str() {
            "ERROR" => 40,
            "WARN" => 30,
            "INFO" => 20,
            _ => 10,
        },
        name: format!("{node}.{}", text("stage")),
        msg: text("message") + &rest,
        file: text("target"),
        ..Log::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_from_now_on_are_messages_also_those_of_a_stream_that_begins_anew() {
        let directory = tempfile::tempdir().unwrap();
        let path = log_stream_file(directory.path());
        let line = |text: &str| {
            format!(
                r#"{{"level":"WARN","message":"{text}","scan":4,"stage":"mapper","target":"m","utc_ns":1500000000}}"#
            ) + "\n"
        };
        std::fs::write(&path, line("before")).unwrap();
        let mut relay = LogRelay::at_the_end(directory.path(), "flockslam");
        assert!(relay.read().is_empty());
        std::fs::write(&path, line("before") + &line("now") + "torn\n").unwrap();
        std::fs::rename(&path, directory.path().join("old")).unwrap();
        std::fs::write(&path, line("new")).unwrap();
        let found = relay.read();
        let texts: Vec<_> = found.iter().map(|log| log.msg.as_str()).collect();
        assert_eq!(texts, ["now scan=4", "new scan=4"]);
        assert_eq!(
            (found[0].level, found[0].name.as_str(), found[0].stamp.ns()),
            (30, "flockslam.mapper", 1_500_000_000)
        );
    }
}
