//! Boards, rules and the Prometheus configuration: they name metrics that exist, their own tools accept them, and in a real run
//! that a real Prometheus scrapes, each panel and each recorded rule has something to show.

use crate::support;
use crate::support::flocks::FlockRobot;
use crate::support::machine_share;
use crate::support::{
    Browser, Drive, RunningSet, free_port, http_get, keep_picture, live_building, not_tested, wait_for,
};
use flockslam_messages::Stage;
use flockslam_telemetry::names;
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{SystemTime, UNIX_EPOCH};

const RULES: [&str; 2] = ["recording.yml", "alerts.yml"];
/// The board that shows something only where there are several robots.
const FLOCK_BOARD: &str = "flockslam-flock";
/// What a histogram's series add to its name.
const HISTOGRAM_ENDINGS: [&str; 3] = ["_bucket", "_sum", "_count"];

fn dashboards() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../dashboards")
}

fn text(name: &str) -> String {
    fs::read_to_string(dashboards().join(name)).unwrap()
}

/// A panel's title and what it asks for.
struct Query {
    panel: String,
    expression: String,
}

fn boards() -> Vec<(String, Value)> {
    let mut boards: Vec<_> = fs::read_dir(dashboards().join("grafana/boards"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            (name, serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap())
        })
        .collect();
    boards.sort_by(|a, b| a.0.cmp(&b.0));
    assert!(boards.len() >= 4);
    boards
}

fn queries(name: &str, board: &Value) -> Vec<Query> {
    let panels = board["panels"].as_array().unwrap();
    let of_panel = |panel: &Value| {
        let title = format!("{name}: {}", panel["title"].as_str().unwrap());
        let targets = panel["targets"].as_array().unwrap().clone();
        targets.into_iter().map(move |target| Query {
            panel: title.clone(),
            expression: target["expr"].as_str().unwrap().to_owned(),
        })
    };
    let queries: Vec<_> = panels.iter().flat_map(of_panel).collect();
    assert!(queries.len() >= panels.len(), "{name} has panels without queries");
    queries
}

/// Names that recording rules give.
fn recorded() -> BTreeSet<String> {
    let rules = text("recording.yml");
    let names = rules.lines().filter_map(|line| line.trim().strip_prefix("- record: "));
    let names: BTreeSet<String> = names.map(str::to_owned).collect();
    assert!(!names.is_empty());
    names
}

/// All names of metrics and of recorded rules in a text.
fn named(text: &str) -> BTreeSet<String> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == ':';
    let words = text.split(|c| !is_part(c));
    let of_ours = |word: &&str| word.starts_with(names::PREFIX) || word.starts_with("flockslam:");
    words.filter(of_ours).map(str::to_owned).collect()
}

fn assert_known(place: &str, expression: &str) {
    let recorded = recorded();
    for name in named(expression) {
        let series = HISTOGRAM_ENDINGS.iter().find_map(|ending| name.strip_suffix(ending));
        let is_metric = names::ALL.iter().any(|metric| metric.name == name || Some(metric.name) == series);
        assert!(is_metric || recorded.contains(&name), "{place}: {name} is no metric and no recorded rule");
    }
}

/// The expressions of a file of rules.
fn expressions(file: &str) -> Vec<String> {
    let rules = text(file);
    let expressions: Vec<_> =
        rules.lines().filter_map(|line| line.trim().strip_prefix("expr: ")).map(str::to_owned).collect();
    assert!(expressions.len() >= 5);
    expressions
}

#[test]
fn boards_and_rules_query_existing_metrics() {
    for rules in RULES {
        expressions(rules).iter().for_each(|expression| assert_known(rules, expression));
    }
    let mut titles = BTreeSet::new();
    for (name, board) in boards() {
        assert_eq!(board["uid"].as_str(), Some(name.as_str()));
        for query in queries(&name, &board) {
            assert!(!named(&query.expression).is_empty(), "{}", query.panel);
            assert_known(&query.panel, &query.expression);
            titles.insert(query.panel);
        }
    }
    assert!(titles.len() >= 15);
}

/// Runs a tool of Prometheus; `None`, said clearly, where it is not installed.
fn tool(name: &str, arguments: &[&str], input: &str) -> Option<()> {
    let spawned = Command::new(name)
        .args(arguments)
        .current_dir(dashboards())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let Ok(mut child) = spawned else {
        not_tested(&format!("{name} {}", arguments.join(" ")), "it is not installed (Debian: prometheus)");
        return None;
    };
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    let text = format!("{}{}", support::stdout(&output), support::stderr(&output));
    assert!(output.status.success(), "{name} {arguments:?}: {text}");
    Some(())
}

#[test]
fn promtool_accepts_rules_and_configuration_and_the_alerts_fire_when_they_should() {
    tool("promtool", &["check", "config", "prometheus.yml"], "");
    tool("promtool", &["check", "rules", RULES[0], RULES[1]], "");
    tool("promtool", &["test", "rules", "rules_test.yml"], "");
}

fn get(port: u16, path: &str) -> Option<String> {
    let (head, body) = http_get(port, path)?;
    head.lines().next()?.contains(" 200 ").then_some(body)
}

/// A Prometheus with the project's rules, which scrapes each robot's port several times a second.
struct Prometheus {
    child: Child,
    port: u16,
}

impl Prometheus {
    /// One that scrapes a robot, `r1`, at this port; `None` where it is not installed.
    fn start(directory: &Path, target: u16) -> Option<Self> {
        Self::start_for(directory, &[("r1", target)])
    }

    /// One that scrapes these robots.
    fn start_for(directory: &Path, targets: &[(&str, u16)]) -> Option<Self> {
        for name in RULES {
            fs::copy(dashboards().join(name), directory.join(name)).unwrap();
        }
        fs::create_dir(directory.join("sets")).unwrap();
        for (robot, port) in targets {
            let example = text("sets/r1.yml").replace("127.0.0.1:9464", &format!("127.0.0.1:{port}"));
            let example = example.replace("robot: r1", &format!("robot: {robot}"));
            fs::write(directory.join(format!("sets/{robot}.yml")), example).unwrap();
        }
        let configuration = text("prometheus.yml").replace("_interval: 5s", "_interval: 250ms");
        fs::write(directory.join("prometheus.yml"), configuration).unwrap();
        let port = free_port();
        let spawned = Command::new("prometheus")
            .arg("--config.file=prometheus.yml")
            .arg("--storage.tsdb.path=data")
            .arg(format!("--web.listen-address=127.0.0.1:{port}"))
            .current_dir(directory)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        match spawned {
            Ok(child) => Some(Self { child, port }),
            Err(_) => {
                not_tested("a scrape of a real run", "prometheus is not installed");
                None
            }
        }
    }

    /// The series of an expression between two times, seconds since 1970, four a second.
    fn history(&self, expression: &str, (from_s, to_s): (f64, f64)) -> Value {
        let path = format!(
            "/api/v1/query_range?query={}&start={from_s:.3}&end={to_s:.3}&step=0.25",
            encoded(expression)
        );
        let answer: Value = serde_json::from_str(&get(self.port, &path).unwrap()).unwrap();
        answer["data"]["result"].clone()
    }

    /// The series that an expression has now, or nothing.
    fn series(&self, expression: &str) -> Option<Vec<Value>> {
        let answer = get(self.port, &format!("/api/v1/query?query={}", encoded(expression)))?;
        let answer: Value = serde_json::from_str(&answer).unwrap();
        let series = answer["data"]["result"].as_array().unwrap().clone();
        (!series.is_empty()).then_some(series)
    }
}

fn encoded(text: &str) -> String {
    text.bytes().map(|byte| format!("%{byte:02x}")).collect()
}

impl Drop for Prometheus {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits until every panel of a board shows something, of these robots alone.
fn assert_panels_show(prometheus: &Prometheus, name: &str, board: &Value, robots: &[&str]) {
    for query in queries(name, board) {
        let asked = query.expression.replace("$robot", ".+").replace("$__rate_interval", "5s");
        let series = wait_for(&query.panel, || prometheus.series(&asked));
        assert!(series.iter().all(|one| {
            let robot = one["metric"]["robot"].as_str();
            robot.is_some_and(|robot| robots.contains(&robot)) || query.expression.starts_with("sum by (le)")
        }));
    }
}

#[test]
fn each_panel_of_one_robot_and_each_recorded_rule_has_something_to_show_in_a_real_run() {
    let directory = tempfile::tempdir().unwrap();
    let metrics_port = free_port();
    let scraped = directory.path().join("prometheus");
    fs::create_dir(&scraped).unwrap();
    let Some(prometheus) = Prometheus::start(&scraped, metrics_port) else { return };
    let mut args = live_building(500, 10);
    args.extend(["--metrics-port".to_owned(), metrics_port.to_string()]);
    let mut set = RunningSet::start("dashboards", &directory.path().join("out"), &args);
    set.wait_until_handled(Stage::SyncManager, 20);
    let page = wait_for("the merged page", || get(metrics_port, "/metrics"));
    tool("promtool", &["check", "metrics"], &page);
    for (name, board) in boards().into_iter().filter(|(name, _)| name != FLOCK_BOARD) {
        assert_panels_show(&prometheus, &name, &board, &["r1"]);
    }
    for name in recorded() {
        wait_for(&name, || prometheus.series(&name));
    }
    let stages = prometheus.series("flockslam_stage_up == 1").unwrap();
    assert_eq!(stages.len(), Stage::ALL.len());
    support::send(set.supervisor_pid(), Signal::INT);
    set.finish();
}

fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Pictures of the boards with what a real run gave them, in which a stage is killed: each board has several lines. They are drawn by a
/// page of the tests' own, since Grafana is not where tests run: the same panels, queries, units and legends.
#[test]
fn boards_are_drawn_from_a_real_run() {
    machine_share::mostly_waits();
    let Some(browser) = Browser::start("pictures of the boards") else { return };
    let directory = tempfile::tempdir().unwrap();
    let (metrics_port, scraped) = (free_port(), directory.path().join("prometheus"));
    fs::create_dir(&scraped).unwrap();
    let Some(prometheus) = Prometheus::start(&scraped, metrics_port) else { return };
    let mut args = live_building(2000, 4);
    args.extend(["--metrics-port".to_owned(), metrics_port.to_string()]);
    args.extend(["--set", "simulation.walkers=6"].map(str::to_owned));
    let mut set = RunningSet::start("boards", &directory.path().join("out"), &args);
    let started_s = now_s();
    set.wait_until_handled(Stage::ScanMatcher, 500);
    support::send(set.pid(Stage::Mapper), Signal::KILL);
    set.wait_until_handled(Stage::ScanMatcher, 1200);
    let died = format!("{}{{stage=\"mapper\",reason=\"died\"}} > 0", names::STAGE_RESTARTS.name);
    wait_for("the restart of the killed stage", || prometheus.series(&died));
    let span = (started_s, now_s());
    for (name, board) in boards().into_iter().filter(|(name, _)| name != FLOCK_BOARD) {
        draw(&browser, directory.path(), &name, &board, &prometheus, span);
    }
    support::send(set.supervisor_pid(), Signal::INT);
    set.finish();
}

/// Draws a board with what Prometheus has seen between two times.
fn draw(
    browser: &Browser,
    directory: &Path,
    name: &str,
    board: &Value,
    prometheus: &Prometheus,
    span: (f64, f64),
) {
    let mut answers = serde_json::Map::new();
    for panel in board["panels"].as_array().unwrap() {
        for (place, target) in panel["targets"].as_array().unwrap().iter().enumerate() {
            let asked = target["expr"].as_str().unwrap();
            let asked = asked.replace("$robot", ".+").replace("$__rate_interval", "5s");
            answers.insert(format!("{} {place}", panel["id"]), prometheus.history(&asked, span));
        }
    }
    let data = serde_json::json!({ "board": board, "from": span.0, "to": span.1, "answers": answers });
    let page = include_str!("support/boards/board.html").replace("DATA", &data.to_string());
    let file = directory.join(format!("{name}.html"));
    fs::write(&file, page).unwrap();
    browser.resize(1280, 800, false);
    browser.open(&format!("file://{}", file.display()));
    browser.wait_until("a drawn board", "document.body.dataset.drawn");
    let height = browser.script("return document.documentElement.scrollHeight;").as_u64().unwrap();
    browser.resize(1280, height as u32, false);
    let lines =
        browser.script("return document.querySelectorAll('polyline[points]:not([points=\"\"])').length;");
    assert!(lines.as_u64() > Some(3), "{name}: {lines} lines");
    assert_eq!(browser.errors(), [""; 0]);
    keep_picture(&format!("board-{}", name.trim_start_matches("flockslam-")), &browser.screenshot());
}

/// Three robots meet, and one of them dies: the board of the flock shows it, and the alert for it is on its way.
#[test]
fn the_flock_s_board_shows_robots_that_meet_and_one_that_dies() {
    let directory = tempfile::tempdir().unwrap();
    let (ports, names) = ([free_port(), free_port(), free_port()], ["r1", "r2", "r3"]);
    let scraped = directory.path().join("prometheus");
    fs::create_dir(&scraped).unwrap();
    let targets: Vec<_> = names.into_iter().zip(ports).collect();
    let Some(prometheus) = Prometheus::start_for(&scraped, &targets) else { return };
    let drive = Drive { scan_rate_hz: 5.0, duration_s: 2000.0, rate: 5.0 };
    let started_s = now_s();
    let mut robots = FlockRobot::start_scraped("board", directory.path(), drive, &ports);
    for robot in &mut robots {
        robot.wait_for_flock("a map of three robots", |flock| flock.merged && flock.members.len() == 3);
    }
    let (name, board) = boards().into_iter().find(|(name, _)| name == FLOCK_BOARD).unwrap();
    assert_panels_show(&prometheus, &name, &board, &names);
    let in_map = "min(flockslam_flock_members) == 3 and min(flockslam_flock_closures) > 0";
    wait_for("three robots in one map", || prometheus.series(in_map));
    let mut dead = robots.pop().unwrap();
    dead.kill();
    let alert = |state: &str| {
        format!("ALERTS{{alertname=\"FlockslamPeerLost\", robot=\"r1\", alertstate=\"{state}\"}}")
    };
    wait_for("an alert in the making", || prometheus.series(&alert("pending")));
    wait_for("a peer less", || prometheus.series("flockslam_flock_peers{robot=\"r1\"} == 1"));
    if let Some(browser) = Browser::start("the picture of the flock's board") {
        draw(&browser, directory.path(), &name, &board, &prometheus, (started_s, now_s()));
    }
    dead.leave_nothing();
}
