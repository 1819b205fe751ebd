//! Fills the readings of a set: from its description, and from the set that runs.

use super::machine_reader::now_ns;
use super::set_under_examination::{LidarRate, LogProblem, RunningReading, SetReading};
use crate::configuration::Configuration;
use crate::supervisor::{
    Reply, Request, SetDescription, SetFile, SetStatus, ask, is_of_graph, set_metrics_socket,
};
use flockslam_bus::{Needs, RuntimeDir};
use flockslam_lidar_ingest::process::{LidarPlace, LidarSpec, Source};
use flockslam_messages::Stage;
use flockslam_stage::Mode;
use flockslam_telemetry::{log_stream_file, monotonic_ns, names, scrape};
use serde_json::Value;
use std::collections::BTreeMap;
use std::net::{TcpListener, TcpStream, ToSocketAddrs};
use std::path::Path;
use std::time::{Duration, Instant};

/// Rates are measured over this.
const RATES_OVER: Duration = Duration::from_millis(1500);
/// Lines of the log count for so long, nanoseconds.
const PROBLEMS_NS: i64 = 600_000_000_000;
/// Another robot of the flock answers within this.
const ANSWER: Duration = Duration::from_secs(1);
/// Metrics of the set come within this.
const METRICS: Duration = Duration::from_secs(2);

/// What a description says of a set, and how the set of that name runs.
pub fn inspect_description(path: &Path) -> SetReading {
    let mut reading = SetReading { description: Some(path.to_owned()), ..SetReading::default() };
    let description = match SetDescription::read(path) {
        Ok(description) => description,
        Err(error) => {
            reading.refused = Some(error.to_string());
            return reading;
        }
    };
    reading.robot.clone_from(&description.robot);
    reading.running = running(&description.robot);
    reading.map.clone_from(&description.map);
    reading.uses_dds = description.ros.is_some() && !uses_zenoh();
    reading.lacks_known_map = description.localize.clone().filter(|map| !is_of_graph(map) && !map.exists());
    if let Source::Lidars(lidars) = description.source().source {
        of_lidars(&mut reading, &lidars);
    }
    match description.configuration(&[]) {
        Ok(configuration) => of_configuration(&mut reading, &configuration),
        Err(error) => reading.refused = Some(error.to_string()),
    }
    reading
}

/// How a set runs of which no description was given.
pub fn inspect_running(robot: &str) -> SetReading {
    let mut reading =
        SetReading { robot: robot.to_owned(), running: running(robot), ..SetReading::default() };
    let runtime = RuntimeDir::open(&RuntimeDir::path_of(robot));
    let file = runtime.ok().and_then(|runtime| SetFile::read(&runtime.configuration()).ok());
    if let Some(file) = file {
        if let Source::Lidars(lidars) = &file.source {
            of_lidars(&mut reading, lidars);
        }
        of_configuration(&mut reading, &file.configuration);
    }
    reading
}

fn uses_zenoh() -> bool {
    std::env::var("RMW_IMPLEMENTATION").is_ok_and(|name| name.contains("zenoh"))
}

fn of_lidars(reading: &mut SetReading, lidars: &[LidarSpec]) {
    reading.lidars = lidars.len();
    reading.lidar_ports = lidars
        .iter()
        .filter_map(|lidar| match &lidar.place {
            LidarPlace::Port(port) => Some(port.clone()),
            LidarPlace::Address(_) => None,
        })
        .collect();
    reading.lacking_ports = reading.lidar_ports.iter().filter(|port| !port.exists()).cloned().collect();
}

fn of_configuration(reading: &mut SetReading, configuration: &Configuration) {
    let options = configuration.stage_options(Mode::Live);
    let needs = Needs::of(&options.capacity(), |stage| configuration.replicas(stage));
    reading.needs_bytes = Some(needs.total_bytes());
    let placed = configuration.lidar_ingest.lidars.len().max(configuration.lidar_ingest.calibration.len());
    reading.mounted = placed.min(reading.lidars);
    reading.spill.clone_from(&configuration.set.spill_dir);
    let flock = &configuration.sync_manager.flock;
    reading.flock = flock.enabled;
    if flock.enabled {
        let tried = |endpoint: &String| (endpoint.clone(), connect(endpoint).err());
        reading.flock_endpoints = flock.connect.iter().map(tried).collect();
    }
    let page = &configuration.page;
    if page.enabled && reading.running.is_none() && TcpListener::bind(page.listen).is_err() {
        reading.page_taken = Some(page.listen.to_string());
    }
}

/// Whether something listens at an endpoint of zenoh, `tcp/HOST:PORT` or `tls/HOST:PORT`.
fn connect(endpoint: &str) -> Result<(), String> {
    let (_, address) = endpoint.split_once('/').ok_or("no endpoint: tcp/HOST:PORT")?;
    let address = address.split(['?', '#']).next().unwrap_or(address);
    let found = address.to_socket_addrs().map_err(|error| error.to_string())?;
    let mut problem = "the name has no address".to_owned();
    for address in found {
        match TcpStream::connect_timeout(&address, ANSWER) {
            Ok(_) => return Ok(()),
            Err(error) => problem = error.to_string(),
        }
    }
    Err(problem)
}

fn running(robot: &str) -> Option<RunningReading> {
    if !RuntimeDir::running().iter().any(|name| name == robot) {
        return None;
    }
    let path = RuntimeDir::path_of(robot);
    let mut reading = RunningReading { version: version(&path), ..RunningReading::default() };
    reading.problems = problems(&path);
    let metrics = scrape(&set_metrics_socket(&path), METRICS).unwrap_or_default();
    reading.dropped = dropped(&metrics);
    let Some(first) = status(&path) else { return Some(reading) };
    let began = Instant::now();
    std::thread::sleep(RATES_OVER);
    let last = status(&path);
    let took_s = began.elapsed().as_secs_f64();
    if let Some(last) = &last {
        reading.lidar_rates = lidar_rates(&first, last, took_s);
        // A process that was replaced counts from 0.
        reading.handled_hz = handled(last).saturating_sub(handled(&first)) as f64 / took_s;
        let now_ns = monotonic_ns();
        let silent = last.lidars.iter().filter(|lidar| lidar.is_silent(now_ns));
        reading.silent = silent.map(|lidar| lidar.lidar.clone()).collect();
    }
    reading.status = last;
    Some(reading)
}

/// Its file says it in any version.
fn version(runtime: &Path) -> Option<String> {
    let bytes = std::fs::read(runtime.join("set.json")).ok()?;
    let file: Value = serde_json::from_slice(&bytes).ok()?;
    Some(file.get("version")?.as_str()?.to_owned())
}

fn status(runtime: &Path) -> Option<SetStatus> {
    match ask(&runtime.join("control"), &Request::Status) {
        Ok(Reply::Status(status)) => Some(*status),
        _ => None,
    }
}

fn handled(status: &SetStatus) -> u64 {
    let matchers = status.stages.iter().filter(|stage| stage.stage == Stage::ScanMatcher.name());
    matchers.map(|stage| stage.handled).max().unwrap_or(0)
}

fn lidar_rates(first: &SetStatus, last: &SetStatus, took_s: f64) -> Vec<LidarRate> {
    let one_line = last.lidars.len() == 1 && last.lidar_lines.len() == 1;
    last.lidars
        .iter()
        .map(|lidar| {
            let before = first.lidars.iter().find(|before| before.lidar == lidar.lidar);
            let scans = lidar.scans.saturating_sub(before.map_or(0, |before| before.scans));
            let line = last.lidar_lines.iter().find(|line| one_line || line.name == lidar.lidar);
            LidarRate {
                lidar: lidar.lidar.clone(),
                scans_hz: scans as f64 / took_s,
                turns_hz: line.map(|line| line.speed_hz).filter(|hz| *hz > 0.0),
            }
        })
        .collect()
}

/// Drops by reason, from a page of metrics.
fn dropped(page: &str) -> BTreeMap<String, f64> {
    let mut dropped = BTreeMap::new();
    for line in page.lines().filter(|line| line.starts_with(names::DROPPED.name)) {
        let reason = line.split("reason=\"").nth(1).and_then(|rest| rest.split('"').next());
        let count = line.rsplit(' ').next().and_then(|count| count.parse::<f64>().ok());
        if let (Some(reason), Some(count)) = (reason, count) {
            *dropped.entry(reason.to_owned()).or_insert(0.0) += count;
        }
    }
    dropped
}

fn problems(runtime: &Path) -> Vec<LogProblem> {
    let stream = std::fs::read_to_string(log_stream_file(runtime)).unwrap_or_default();
    problems_since(&stream, now_ns() - PROBLEMS_NS)
}

/// Warnings and errors of a stream of log lines since a time, nanoseconds of UTC; what was said most often comes first.
fn problems_since(stream: &str, since_ns: i64) -> Vec<LogProblem> {
    let mut times: BTreeMap<(String, String), u64> = BTreeMap::new();
    for line in stream.lines() {
        let Ok(Value::Object(fields)) = serde_json::from_str(line) else { continue };
        let text = |name: &str| fields.get(name).and_then(Value::as_str).unwrap_or_default().to_owned();
        let is_recent = fields.get("utc_ns").and_then(Value::as_i64).is_some_and(|utc_ns| utc_ns >= since_ns);
        if is_recent && ["WARN", "ERROR"].contains(&text("level").as_str()) {
            let why = ["error", "problem", "reason"].map(text).into_iter().find(|why| !why.is_empty());
            let message = why.map_or_else(|| text("message"), |why| format!("{}: {why}", text("message")));
            *times.entry((text("stage"), message)).or_default() += 1;
        }
    }
    let problem = |((stage, message), times)| LogProblem { stage, message, times };
    let mut problems: Vec<LogProblem> = times.into_iter().map(problem).collect();
    problems.sort_by_key(|problem| std::cmp::Reverse(problem.times));
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recent_warnings_are_counted_and_other_lines_are_not() {
        let line = |level: &str, message: &str, utc_ns: i64| {
            format!(
                "{{\"level\":\"{level}\",\"message\":\"{message}\",\"stage\":\"mapper\",\"utc_ns\":{utc_ns}}}\n"
            )
        };
        let stream = [
            line("WARN", "late", 5),
            line("ERROR", "gone", 20),
            line("WARN", "late", 20),
            line("WARN", "late", 30),
            line("INFO", "fine", 30),
            "torn".to_owned(),
        ];
        let problems = problems_since(&stream.concat(), 10);
        let listed: Vec<_> =
            problems.iter().map(|problem| (problem.message.as_str(), problem.times)).collect();
        assert_eq!(listed, [("late", 2), ("gone", 1)]);
        let why = r#"{"level":"WARN","message":"m","error":"e","stage":"s","utc_ns":1}"#;
        assert_eq!(problems_since(why, 0)[0].message, "m: e");
    }

    #[test]
    fn drops_are_summed_over_processes() {
        let page = "# HELP flockslam_dropped_total x\nflockslam_dropped_total{stage=\"a\",reason=\"overload\"} 2\n\
                    flockslam_dropped_total{stage=\"b\",reason=\"overload\"} 1\nflockslam_other 3\n";
        assert_eq!(dropped(page), BTreeMap::from([("overload".to_owned(), 3.0)]));
    }

    #[test]
    fn an_endpoint_answers_where_something_listens() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        assert_eq!(connect(&format!("tcp/{address}")), Ok(()));
        // A port of its own, not the one just closed: a process that another test starts can hold that open for an instant.
        assert!(connect("tcp/127.0.0.1:1").is_err() && connect("nonsense").is_err());
    }

    #[test]
    fn a_description_is_inspected_without_a_set() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("set.toml");
        let port = directory.path().join("lidar");
        let text = format!(
            "robot = \"nobody-runs-me\"\nlocalize = \"no-map\"\nset = [\"page.enabled=false\"]\n\
             source = {{ kind = \"ld06\", port = {port:?} }}\n"
        );
        std::fs::write(&path, &text).unwrap();
        let reading = inspect_description(&path);
        assert_eq!((reading.refused, reading.lidars, reading.mounted), (None, 1, 0));
        assert_eq!((&reading.lidar_ports, &reading.lacking_ports), (&vec![port.clone()], &vec![port]));
        assert!(reading.lacks_known_map.is_some() && reading.needs_bytes.is_some());
        assert!(reading.running.is_none());
        std::fs::write(&path, "robt = 1\n").unwrap();
        assert!(inspect_description(&path).refused.unwrap().contains("robt"));
    }
}
