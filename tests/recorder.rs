//! `flockslam record`: the file is whole and opens with the public tools, a websocket serves the public client, and nobody is held
//! up by a recorder, however it ends.

use crate::support;
use crate::support::tools::{self, tool};
use crate::support::{
    Drive, LiveSet, Outputs, RunningSet, flockslam, run_well, send, simulated_log, stderr, stdout, wait_for,
};
use flockslam::recording::RecordTopic;
use flockslam::supervisor::Request;
use flockslam_messages::{ScanHeader, Stage};
use mcap::read::{MessageStream, Options};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const DRIVE: Drive = Drive { scan_rate_hz: 10.0, duration_s: 2000.0, rate: 5.0 };

/// A recorder at work; killed when it is dropped.
pub struct Recorder(pub Child);

impl Recorder {
    fn start(set: &LiveSet, args: &[&str]) -> Self {
        Self::of_robot(set.robot(), args)
    }

    /// Records a set under its name.
    pub fn of_robot(robot: &str, args: &[&str]) -> Self {
        let mut command = flockslam();
        command.arg("record").args(args).args(["--robot", robot]);
        Self(command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap())
    }

    /// Ends it in good order.
    fn finish(mut self) {
        send(self.0.id(), Signal::INT);
        let status = wait_for("the end of the recorder", || self.0.try_wait().unwrap());
        assert_eq!(status.code(), Some(0));
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A set whose matcher also logs, so that there is something on every topic.
fn talking_set(test: &str, directory: &Path) -> LiveSet {
    let mut set = LiveSet::start(test, directory, DRIVE, "");
    set.wait_until_handled(Stage::SyncManager, 20);
    set.ask(&Request::Log("scan-matcher".to_owned(), "debug".to_owned())).unwrap();
    set
}

/// Messages of a file, by topic; one that was not finished is read as far as it goes.
fn messages(path: &Path, options: Option<Options>) -> BTreeMap<String, Vec<Value>> {
    let bytes = std::fs::read(path).unwrap_or_default();
    let mut topics = BTreeMap::<_, Vec<_>>::new();
    let Ok(stream) = MessageStream::new_with_options(&bytes, options.into_iter().collect()) else {
        return topics;
    };
    for message in stream.map_while(Result::ok) {
        let is_json = message.channel.message_encoding == "json";
        let value = if is_json { serde_json::from_slice(&message.data).unwrap() } else { Value::Null };
        topics.entry(message.channel.topic.clone()).or_default().push(value);
    }
    topics
}

/// Waits until a file has something on every topic, and enough poses.
fn wait_until_full(path: &Path) {
    wait_for("a message on every topic", || {
        let seen = messages(path, Some(Options::IgnoreEndMagic));
        let poses = seen.get("/pose").map_or(0, Vec::len);
        (seen.len() == RecordTopic::COUNT && poses > 40).then_some(())
    });
}

#[test]
fn a_file_is_whole_after_its_end_and_readable_after_a_kill_and_the_set_does_not_mind() {
    let directory = tempfile::tempdir().unwrap();
    let mut set = talking_set("record", directory.path());
    let (ended, killed) = (directory.path().join("ended.mcap"), directory.path().join("killed.mcap"));
    let victim = Recorder::start(&set, &[killed.to_str().unwrap()]);
    let recorder = Recorder::start(&set, &[ended.to_str().unwrap()]);
    wait_until_full(&ended);
    wait_until_full(&killed);
    drop(victim);
    recorder.finish();
    let left = messages(&killed, Some(Options::IgnoreEndMagic));
    assert_eq!(left.len(), RecordTopic::COUNT, "the file of the killed recorder: {:?}", left.keys());
    assert!(left["/pose"].len() > 40, "{} poses", left["/pose"].len());
    let seen = messages(&ended, None);
    assert_eq!(seen.len(), RecordTopic::COUNT, "{:?}", seen.keys());
    let number = |value: &Value| value.as_f64().unwrap();
    for scan in &seen["/scan"] {
        let ranges = scan["ranges"].as_array().unwrap();
        assert!(ranges.len() > 100 && ranges.iter().any(|range| number(range) > 0.0), "{scan}");
    }
    let stamps: Vec<_> = seen["/pose"]
        .iter()
        .map(|pose| (pose["timestamp"]["sec"].as_u64().unwrap(), pose["timestamp"]["nsec"].as_u64().unwrap()))
        .collect();
    assert!(
        stamps.is_sorted()
            && seen["/tf"].len() >= 3 * stamps.len()
            && seen["/odom_pose"].len() == stamps.len()
    );
    let moved =
        |pose: &Value| number(&pose["pose"]["position"]["x"]).hypot(number(&pose["pose"]["position"]["y"]));
    assert!(seen["/pose"].iter().any(|pose| moved(pose) > 0.5));
    assert!(seen["/log"].iter().any(|line| line["name"] == "scan-matcher"));
    let refused = set.command(&["record", ended.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    let nothing = set.command(&["record"]);
    assert_eq!(nothing.status.code(), Some(2));
    let status = set.status().unwrap();
    assert!(status.stages.iter().all(|stage| stage.restarts == 0), "{status:?}");
    let handled = support::of(&status, Stage::ScanMatcher).handled;
    set.wait_until_handled(Stage::ScanMatcher, handled + 20);
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}

#[test]
fn the_recording_of_a_set_is_mapped_to_the_same_bytes_and_one_changed_byte_is_seen() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let args = ["map", "--source", "-"].map(str::to_owned);
    let mut set = RunningSet::start_with_pipe("recorded", &place.join("seen"), &args);
    set.pid(Stage::SyncManager);
    let file = place.join("drive.mcap");
    let mut recorder = Recorder::of_robot(set.robot(), &[file.to_str().unwrap()]);
    wait_for("the recorder", || file.exists().then_some(()));
    let mut stdin = set.stdin.take().unwrap();
    for line in simulated_log(20.0).lines() {
        writeln!(stdin, "{line}").unwrap();
        // Of so many scans a second the queue holds those of some seconds: the recorder may not miss one, however busy the machine is.
        std::thread::sleep(Duration::from_millis(40));
    }
    drop(stdin);
    // The set ends with its pipe, and the recorder with the set.
    let mut said = String::new();
    recorder.0.stdout.take().unwrap().read_to_string(&mut said).unwrap();
    let seen = set.finish();
    assert!(said.contains("missed 0 scans"), "{said}");
    let replayed = |name: &str| {
        let args = ["map".to_owned(), place.join(name).display().to_string()];
        run_well("replayed", &place.join("replayed"), &args)
    };
    let same = |outputs: &Outputs| {
        let names = ["trajectory.tum", "trajectory_online.tum", "map.pgm"];
        names.map(|name| outputs.bytes(name)) == names.map(|name| seen.bytes(name))
            && outputs.report.map_hash == seen.report.map_hash
    };
    let again = replayed("drive.mcap");
    assert_eq!(again.report.scans, seen.report.scans, "the recording lacks its end");
    assert!(same(&again));
    // A byte in the middle of the ranges of the scan in the middle.
    let mut bytes = std::fs::read(&file).unwrap();
    let stream = MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let scans: Vec<_> = stream.filter(|message| message.channel.topic == "/flockslam/scan").collect();
    let scan = scans[scans.len() / 2].data.to_vec();
    drop(scans);
    let at = bytes.windows(scan.len()).position(|window| window == scan).unwrap();
    let sign_and_exponent = at + size_of::<ScanHeader>() + 4 * 90 + 2;
    bytes[sign_and_exponent] ^= 0x40;
    std::fs::write(place.join("changed.mcap"), bytes).unwrap();
    assert!(!same(&replayed("changed.mcap")));
}

/// Opens a file with the public package and holds each message against its schema.
const READ_MCAP: &str = r#"
import json, sys
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
validators, counts = {}, {}
with open(sys.argv[1], "rb") as stream:
    for schema, channel, message in make_reader(stream).iter_messages():
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
        if channel.topic.startswith("/flockslam/"):
            continue
        assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
        if schema.id not in validators:
            Draft202012Validator.check_schema(json.loads(schema.data))
            validators[schema.id] = Draft202012Validator(json.loads(schema.data))
        validators[schema.id].validate(json.loads(message.data))
print(json.dumps(counts))
"#;

#[test]
fn the_public_python_package_opens_a_file_and_its_schemas_hold() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let Some(python) = tools::RECORDINGS.python() else { return };
    let mut set = talking_set("python", place);
    let file = place.join("drive.mcap");
    let recorder = Recorder::start(&set, &[file.to_str().unwrap()]);
    wait_until_full(&file);
    recorder.finish();
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
    std::fs::write(place.join("read.py"), READ_MCAP).unwrap();
    let output = Command::new(python).arg("read.py").arg(&file).current_dir(place).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let counts: BTreeMap<String, usize> = serde_json::from_str(&stdout(&output)).unwrap();
    println!("read by the package: {counts:?}");
    let ours: BTreeMap<_, _> =
        messages(&file, None).into_iter().map(|(topic, messages)| (topic, messages.len())).collect();
    assert_eq!(counts, ours);
}

/// Subscribes to all channels with the public client, and prints the topics once each has had a message.
const READ_SOCKET: &str = r#"
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");
const client = new FoxgloveClient({ ws: new WebSocket(process.argv[2], [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const topics = new Map(), seen = new Set();
client.on("error", (error) => { console.error(error); process.exit(1); });
client.on("advertise", (channels) => {
  for (const channel of channels) {
    JSON.parse(channel.schema);
    topics.set(client.subscribe(channel.id), channel.topic);
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const message = JSON.parse(new TextDecoder().decode(data));
  if (typeof timestamp !== "bigint" || (message.timestamp ?? message.entities) === undefined) process.exit(2);
  seen.add(topics.get(subscriptionId));
  if (seen.size === topics.size) { console.log(JSON.stringify([...seen].sort())); process.exit(0); }
});
setTimeout(() => { console.error("only", [...seen]); process.exit(3); }, 60000);
"#;

#[test]
fn the_public_client_of_foxglove_is_served() {
    let directory = tempfile::tempdir().unwrap();
    let place = directory.path();
    let installed = || {
        tool(place, Path::new("node"), &["--version"])?;
        let args = ["install", "--silent", "--no-fund", "--no-audit", "@foxglove/ws-protocol", "ws"];
        tool(place, Path::new("npm"), &args)
    };
    if installed().is_none() {
        return;
    }
    let mut set = talking_set("foxglove", place);
    let mut recorder = Recorder::start(&set, &["--foxglove", "0"]);
    let mut text = String::new();
    BufReader::new(recorder.0.stdout.take().unwrap()).read_line(&mut text).unwrap();
    let address = text.trim().rsplit(' ').next().unwrap().to_owned();
    std::fs::write(place.join("read.js"), READ_SOCKET).unwrap();
    let output = Command::new("node").args(["read.js", &address]).current_dir(place).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let mut topics = RecordTopic::OF_JSON.map(RecordTopic::name);
    topics.sort_unstable();
    assert_eq!(serde_json::from_str::<Vec<String>>(&stdout(&output)).unwrap(), topics);
    recorder.finish();
    set.command_well(&["down"]);
    assert_eq!(set.wait(), Some(0));
}
