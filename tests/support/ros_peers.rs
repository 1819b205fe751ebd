//! Nodes of ROS 2 that a set speaks with, by the client library of ROS and by Cyclone DDS, from the public index.

use super::{LiveSet, flockslam, repository, robot, tools, wait_for};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Lines, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

/// Cyclone DDS on the loopback interface, which has no multicast.
const CYCLONE: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\"/></Interfaces>\
    <AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <MaxAutoParticipantIndex>40</MaxAutoParticipantIndex><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>";
/// Ports of domains beyond lie among those that Linux hands out.
const DOMAINS: u32 = 100;

/// A domain of ROS that no other test has, and the interpreter that peers run in.
pub struct Graph {
    domain: u32,
    python: PathBuf,
}

/// The folder with the definitions of the packages of ROS; `None` where they cannot be installed.
pub fn packages_of_ros() -> Option<PathBuf> {
    tools::ROS.python().map(|python| python.with_file_name("../share"))
}

impl Graph {
    /// A graph of its own; `None` where peers cannot be run.
    pub fn new() -> Option<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let python = tools::ROS.python()?;
        let next = std::process::id() * 7 + NEXT.fetch_add(1, Ordering::Relaxed);
        Some(Self { domain: 1 + next % DOMAINS, python })
    }

    fn put_into_graph(&self, command: &mut Command) {
        command.env("ROS_DOMAIN_ID", self.domain.to_string()).env("ROS_LOCALHOST_ONLY", "1");
        command.env("CYCLONEDDS_URI", CYCLONE).env("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp");
    }

    /// Starts a set that takes its scans from the graph, as a node with these arguments.
    pub fn set(&self, test: &str, directory: &Path, arguments: &[&str]) -> LiveSet {
        self.set_with(test, directory, arguments, &[])
    }

    /// As [`Self::set`], of a set that localizes in a map.
    pub fn localizing_set(&self, test: &str, directory: &Path, map: &Path) -> LiveSet {
        let robot = robot(test);
        let description = format!(
            "robot = \"{robot}\"\nlocalize = {map:?}\nset = [\"page.enabled=false\"]\n[source]\nkind = \"scans\"\n[ros]\nargs = [\"-p\", \"resolution:=0.045\"]\n"
        );
        std::fs::write(directory.join("set.toml"), description).unwrap();
        let mut command = flockslam();
        self.put_into_graph(&mut command);
        LiveSet::start_described(command, robot, directory)
    }

    /// As [`Self::set`], with more variables in its environment.
    pub fn set_with(
        &self,
        test: &str,
        directory: &Path,
        arguments: &[&str],
        variables: &[(&str, &str)],
    ) -> LiveSet {
        let robot = robot(test);
        let description = format!(
            "robot = \"{robot}\"\nset = [\"page.enabled=false\"]\n[source]\nkind = \"scans\"\n[ros]\nargs = {}\n",
            json!(arguments)
        );
        std::fs::write(directory.join("set.toml"), description).unwrap();
        let mut command = flockslam();
        self.put_into_graph(&mut command);
        command.envs(variables.iter().copied());
        LiveSet::start_described(command, robot, directory)
    }

    /// Starts a node that obeys.
    pub fn peer(&self, name: &str) -> Peer {
        let mut child = self.script("peer.py", &[name]);
        let orders = child.stdin.take().unwrap();
        let answers = BufReader::new(child.stdout.take().unwrap()).lines();
        Peer { child, orders, answers }
    }

    /// Plays a log into the graph, this many log seconds a second, in a namespace; returns what the robot has noted.
    pub fn play(&self, log: &Path, rate: f64, namespace: &str) -> Value {
        self.play_with(log, rate, namespace, &[])
    }

    /// As [`Self::play`]; odometry goes so much farther than it should, and begins anew in the middle.
    pub fn play_with_wheels(&self, log: &Path, rate: f64, wheels: f64) -> Value {
        self.play_with(log, rate, "/", &[&wheels.to_string()])
    }

    /// As [`Self::play`], with the time of the log by `/clock`, which goes back before each further round.
    pub fn play_again(&self, log: &Path, rate: f64, rounds: u32) -> Value {
        self.play_with(log, rate, "/", &["1", &rounds.to_string()])
    }

    fn play_with(&self, log: &Path, rate: f64, namespace: &str, more: &[&str]) -> Value {
        let out = log.with_extension("noted.json");
        let out_text = out.display().to_string();
        let (log_text, rate_text) = (log.display().to_string(), rate.to_string());
        let arguments =
            [&[log_text.as_str(), rate_text.as_str(), namespace, out_text.as_str()], more].concat();
        noted(self.script("robot.py", &arguments), &out)
    }

    /// A robot in a graph of rmw_zenoh, whose router is at this port; it plays a log as soon as somebody subscribes.
    pub fn zenoh_robot(&self, port: u16, log: &Path, rate: f64) -> ZenohRobot {
        let out = log.with_extension("noted.json");
        let texts =
            [port.to_string(), log.display().to_string(), rate.to_string(), out.display().to_string()];
        let mut child = self.script("zenoh_robot.py", &texts.each_ref().map(String::as_str));
        let mut said = BufReader::new(child.stdout.take().unwrap()).lines();
        assert_eq!(said.next().expect("the robot says that it is ready").unwrap(), "ready");
        ZenohRobot { child, out }
    }

    /// Begins to send what no node should, to these ports, and that many messages a second on `/tf`.
    pub fn hostile(&self, seconds: u32, rate: u32, ports: &[u16]) -> Child {
        let numbers = [seconds, rate].into_iter().chain(ports.iter().map(|port| u32::from(*port)));
        let arguments: Vec<_> = numbers.map(|number| number.to_string()).collect();
        self.script("hostile.py", &arguments.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn script(&self, name: &str, arguments: &[&str]) -> Child {
        let mut command = Command::new(&self.python);
        command.arg(repository().join("tests/ros_peers").join(name)).args(arguments);
        self.put_into_graph(&mut command);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        command.spawn().unwrap()
    }
}

/// Waits for the end of a drive; what was noted.
fn noted(mut child: Child, out: &Path) -> Value {
    drop(child.stdin.take());
    let status = wait_for("the end of the drive", || child.try_wait().unwrap());
    assert!(status.success(), "the robot: {status}");
    serde_json::from_slice(&std::fs::read(out).unwrap()).unwrap()
}

/// A robot in a graph of rmw_zenoh.
pub struct ZenohRobot {
    child: Child,
    out: PathBuf,
}

impl ZenohRobot {
    /// Waits for the end of its drive; what it has noted.
    pub fn noted(self) -> Value {
        noted(self.child, &self.out)
    }
}

/// The UDP ports that a process has opened.
pub fn udp_ports(pid: u32) -> Vec<u16> {
    let descriptors = std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap();
    let links: Vec<_> = descriptors
        .filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok())
        .map(|link| link.display().to_string())
        .collect();
    let table = std::fs::read_to_string(format!("/proc/{pid}/net/udp")).unwrap();
    let port = |line: &str| {
        let fields: Vec<_> = line.split_whitespace().collect();
        let is_own = links.contains(&format!("socket:[{}]", fields.get(9)?));
        let port = u16::from_str_radix(fields[1].split(':').nth(1)?, 16).ok()?;
        (is_own && port > 0).then_some(port)
    };
    let mut ports: Vec<_> = table.lines().filter_map(port).collect();
    ports.sort_unstable();
    ports.dedup();
    ports
}

/// A node of the client library of ROS that obeys.
pub struct Peer {
    child: Child,
    orders: ChildStdin,
    answers: Lines<BufReader<ChildStdout>>,
}

impl Peer {
    /// Tells it what to do, and waits until it is done. What tests/ros_peers/peer.py says it can.
    pub fn tell(&mut self, command: &Value) -> Value {
        writeln!(self.orders, "{command}").unwrap();
        let answer = self.answers.next().unwrap_or_else(|| panic!("the peer has died at {command}")).unwrap();
        serde_json::from_str(&answer).unwrap()
    }

    /// Calls a service; its fields.
    pub fn call(&mut self, kind: &str, name: &str, fields: Value) -> Value {
        let answer = self.tell(&json!(["call", kind, name, fields]));
        assert!(!answer.is_null(), "{name} does not answer");
        answer
    }

    /// The map as somebody gets it who comes late: what is said of it, and its cells.
    pub fn map(&mut self, directory: &Path) -> (Value, Vec<i8>) {
        let cells = directory.join("cells");
        let found = self.tell(&json!(["map", cells]));
        assert!(!found.is_null(), "no map came");
        (found, std::fs::read(cells).unwrap().into_iter().map(|byte| byte as i8).collect())
    }

    /// Asks until the answer is as wanted.
    pub fn wait_for<T>(&mut self, what: &str, command: &Value, mut is: impl FnMut(&Value) -> Option<T>) -> T {
        wait_for(what, || is(&self.tell(command)))
    }

    /// Ends it in the middle of what it does.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
