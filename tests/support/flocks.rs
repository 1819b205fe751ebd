//! Robots of a flock, the network between them, and who means them harm.

use crate::support::{Drive, LiveSet, flockslam, free_port, not_tested, send, wait_for};
use flockslam_records::{Content, MESSAGE_BYTES_MAX, Message, Record, RobotKey, Vector, Withdrawal};
use flockslam_results::FlockStatus;
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use zenoh::Wait;

/// How long robots that have ended wait for each other: shorter than what a test waits for.
const WAIT_MAX_S: u32 = 60;
/// Where robots drive if nothing is said.
const WORLD: &str = "office";

/// A robot of a flock: a process set of its own.
pub struct FlockRobot {
    pub set: LiveSet,
    name: String,
    endpoint: String,
    directory: PathBuf,
}

impl FlockRobot {
    /// Starts robots that know where to find each other on this machine.
    pub fn start_all(test: &str, directory: &Path, drive: Drive, count: usize) -> Vec<Self> {
        Self::start_with(test, directory, drive, count, "")
    }

    /// As [`FlockRobot::start_all`], with more lines of TOML in the section of the flock.
    pub fn start_with(test: &str, directory: &Path, drive: Drive, count: usize, more: &str) -> Vec<Self> {
        let endpoints: Vec<String> = (0..count).map(|_| format!("tcp/127.0.0.1:{}", free_port())).collect();
        let start = |number: usize| {
            Self::start(test, directory, &endpoints, number, (WORLD, more), |set, description, more| {
                LiveSet::start(set, description, drive, more)
            })
        };
        (0..count).map(start).collect()
    }

    /// As [`FlockRobot::start_all`], each robot with its metrics at one of these ports.
    pub fn start_scraped(test: &str, directory: &Path, drive: Drive, ports: &[u16]) -> Vec<Self> {
        let endpoints: Vec<String> = ports.iter().map(|_| format!("tcp/127.0.0.1:{}", free_port())).collect();
        let start = |(number, port): (usize, &u16)| {
            Self::start(test, directory, &endpoints, number, (WORLD, ""), |set, description, more| {
                LiveSet::start(set, description, drive, &format!("{more}\nmetrics_port = {port}"))
            })
        };
        ports.iter().enumerate().map(start).collect()
    }

    /// As [`FlockRobot::start_all`], the first robot with its page at this port.
    pub fn start_with_page(test: &str, directory: &Path, drive: Drive, count: usize, port: u16) -> Vec<Self> {
        let endpoints: Vec<String> = (0..count).map(|_| format!("tcp/127.0.0.1:{}", free_port())).collect();
        let start = |number: usize| {
            Self::start(test, directory, &endpoints, number, (WORLD, ""), |set, description, more| {
                let page = ["page.enabled=true".to_owned(), format!("page.listen=127.0.0.1:{port}")];
                let arguments: Vec<String> =
                    page.into_iter().flat_map(|setting| ["--set".to_owned(), setting]).collect();
                let arguments = if number == 0 { &arguments[..] } else { &[] };
                LiveSet::start_with_failpoints(set, description, drive, more, arguments, "")
            })
        };
        (0..count).map(start).collect()
    }

    /// As [`FlockRobot::start_all`], each robot with certificates.
    pub fn start_certified(
        test: &str,
        directory: &Path,
        drive: Drive,
        certificates: &[&Certificates],
    ) -> Vec<Self> {
        let endpoints: Vec<String> =
            certificates.iter().map(|_| format!("tls/127.0.0.1:{}", free_port())).collect();
        let start = |(number, Certificates { ca, certificate, key }): (usize, &&Certificates)| {
            let more = format!("tls_ca = {ca:?}\ntls_certificate = {certificate:?}\ntls_key = {key:?}");
            Self::start(test, directory, &endpoints, number, (WORLD, &more), |set, description, more| {
                LiveSet::start(set, description, drive, more)
            })
        };
        certificates.iter().enumerate().map(start).collect()
    }

    /// One robot of those at these endpoints.
    pub fn start_one(
        test: &str,
        directory: &Path,
        drive: Drive,
        endpoints: &[String],
        number: usize,
        (world, more): (&str, &str),
    ) -> Self {
        Self::start(test, directory, endpoints, number, (world, more), |set, description, more| {
            LiveSet::start(set, description, drive, more)
        })
    }

    /// A robot in each namespace; at the end of their drives they stay until both have ended.
    pub fn start_in(namespaces: &[Namespace; 2], test: &str, directory: &Path, drive: Drive) -> Vec<Self> {
        let endpoints: Vec<String> =
            namespaces.iter().map(|space| format!("tcp/{}:7447", space.address)).collect();
        let more = format!("wait_for_robots = 1\nwait_max_s = {WAIT_MAX_S}.0");
        let start = |(number, space): (usize, &Namespace)| {
            Self::start(test, directory, &endpoints, number, (WORLD, &more), |set, description, more| {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", &space.name]).arg(flockslam().get_program());
                LiveSet::start_by(command, set, description, drive, more)
            })
        };
        namespaces.iter().enumerate().map(start).collect()
    }

    fn start(
        test: &str,
        directory: &Path,
        endpoints: &[String],
        number: usize,
        (world, more): (&str, &str),
        launch: impl FnOnce(&str, &Path, &str) -> LiveSet,
    ) -> Self {
        let name = format!("robot-{number}");
        let own = directory.join(&name);
        std::fs::create_dir_all(&own).unwrap();
        let others: Vec<&String> = endpoints.iter().filter(|other| **other != endpoints[number]).collect();
        let flock = format!("{test}-{}", std::process::id());
        let configuration = format!(
            "[simulation]\nworld = \"{world}\"\nseed = {}\nlead_s = {}.0\n[sync_manager.flock]\nname = \"{name}\"\nenabled = true\n\
             flock = \"{flock}\"\nlisten = [{:?}]\nconnect = {others:?}\nkey_file = {:?}\n{more}\n",
            number + 1,
            40 * number,
            endpoints[number],
            own.join("robot.key"),
        );
        std::fs::write(own.join("flock.toml"), configuration).unwrap();
        let set = launch(test, &own, "config = \"flock.toml\"");
        Self { set, name, endpoint: endpoints[number].clone(), directory: own }
    }

    /// Its name in the flock.
    pub fn name(&self) -> String {
        self.name.clone()
    }

    /// What it tells of its flock; `None` as long as it tells nothing.
    pub fn flock(&self) -> Option<FlockStatus> {
        self.set.status()?.flock
    }

    /// Its address on the network.
    pub fn address(&self) -> String {
        let flock = wait_for("a robot that tells of its flock", || self.flock());
        format!("{}-{}", self.name, &flock.public_key[..16])
    }

    /// Waits until what it tells of its flock is as asked for.
    pub fn wait_for_flock(&mut self, what: &str, is: impl Fn(&FlockStatus) -> bool) -> FlockStatus {
        let last = std::cell::RefCell::new(None);
        let waited = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let status = self.set.wait_until(what, |status| {
                last.borrow_mut().clone_from(&status.flock);
                status.flock.as_ref().is_some_and(&is)
            });
            status.flock.unwrap()
        }));
        waited.unwrap_or_else(|problem| {
            println!("{}: {:#?}", self.name, last.borrow());
            std::panic::resume_unwind(problem)
        })
    }

    /// Kills all of it.
    pub fn kill(&mut self) {
        send(self.set.supervisor_pid(), Signal::KILL);
        self.set.wait_for_death();
    }

    /// Starts a robot that was killed again, with nothing left of it but its key.
    pub fn start_without_log(self) -> Self {
        std::fs::remove_dir_all(self.set.runtime_dir()).unwrap();
        Self { set: self.set.start_once_more(), ..self }
    }

    /// Gives up what a robot that was killed has left for a successor that will not come: the next start of any set removes it, in
    /// shared memory as well.
    pub fn leave_nothing(self) {
        let _ = std::fs::remove_file(self.set.runtime_dir().join("kept"));
    }

    /// Waits for the end of its source; gives its last status of the flock.
    pub fn finish(self) -> FlockStatus {
        self.set.finish();
        FlockStatus::read(&self.directory.join("out")).unwrap()
    }
}

/// A network namespace with an address, connected to one other.
pub struct Namespace {
    pub name: String,
    pub address: String,
    link: String,
}

impl Namespace {
    /// Two that are connected; `None`, said clearly, where that cannot be had.
    pub fn pair(test: &str) -> Option<[Self; 2]> {
        let number = std::process::id();
        let spaces = ["a", "b"].map(|side| Self {
            name: format!("{test}-{number}-{side}"),
            address: format!(
                "10.{}.{}.{}",
                64 + number % 64,
                number / 64 % 256,
                if side == "a" { 1 } else { 2 }
            ),
            link: format!("fs{number}{side}"),
        });
        let made = spaces.iter().all(|space| ip(&["netns", "add", &space.name]))
            && ip(&["link", "add", &spaces[0].link, "type", "veth", "peer", "name", &spaces[1].link])
            && spaces.iter().all(Self::set_up);
        if made {
            return Some(spaces);
        }
        not_tested("links that are cut", "no network namespace can be made (root and iproute2 are needed)");
        None
    }

    fn set_up(&self) -> bool {
        let Self { name, address, link } = self;
        ip(&["link", "set", link, "netns", name])
            && ip(&["-n", name, "addr", "add", &format!("{address}/24"), "dev", link])
            && ip(&["-n", name, "link", "set", link, "up"])
            && ip(&["-n", name, "link", "set", "lo", "up"])
    }

    /// Cuts its link, or mends it.
    pub fn cut(&self, cut: bool) {
        let state = if cut { "down" } else { "up" };
        assert!(ip(&["-n", &self.name, "link", "set", &self.link, state]));
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        ip(&["netns", "del", &self.name]);
    }
}

fn ip(arguments: &[&str]) -> bool {
    let run = Command::new("ip").args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    run.is_ok_and(|status| status.success())
}

/// The files that a robot needs for mutual TLS.
pub struct Certificates {
    pub ca: PathBuf,
    pub certificate: PathBuf,
    pub key: PathBuf,
}

/// Certificates of two authorities that know nothing of each other; `None`, said clearly, where there is no openssl.
pub fn own_certificates(directory: &Path) -> Option<[Certificates; 2]> {
    if Command::new("openssl").arg("version").output().is_err() {
        not_tested("mutual TLS", "openssl is not installed");
        return None;
    }
    Some(["one", "two"].map(|authority| certificates(&directory.join(authority))))
}

fn certificates(directory: &Path) -> Certificates {
    std::fs::create_dir_all(directory).unwrap();
    let openssl = |arguments: &[&str]| {
        let output = Command::new("openssl").args(arguments).current_dir(directory).output().unwrap();
        assert!(output.status.success(), "{}", crate::support::stderr(&output));
    };
    let new_key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"];
    let extensions =
        "basicConstraints=CA:FALSE\nsubjectAltName=IP:127.0.0.1\nextendedKeyUsage=serverAuth,clientAuth\n";
    std::fs::write(directory.join("robot.ext"), extensions).unwrap();
    let authority =
        ["req", "-x509", "-days", "30", "-subj", "/CN=authority", "-keyout", "ca.key", "-out", "ca.pem"];
    openssl(&[&authority[..], &new_key].concat());
    let request = ["req", "-subj", "/CN=robot", "-keyout", "robot.key", "-out", "robot.csr"];
    openssl(&[&request[..], &new_key].concat());
    openssl(&[
        "x509",
        "-req",
        "-in",
        "robot.csr",
        "-CA",
        "ca.pem",
        "-CAkey",
        "ca.key",
        "-CAcreateserial",
        "-days",
        "30",
        "-extfile",
        "robot.ext",
        "-out",
        "robot.pem",
    ]);
    Certificates {
        ca: directory.join("ca.pem"),
        certificate: directory.join("robot.pem"),
        key: directory.join("robot.key"),
    }
}

/// Sends a robot so many messages a second that mean nothing, now under one name, now under ever new ones, until it is over; gives how many
/// that were.
pub fn flood(robot: &FlockRobot, per_s: u32, over: &AtomicBool) -> usize {
    let victim = robot.address();
    let flock = robot.flock().unwrap().flock;
    let session = outside_session(robot);
    let rubbish: Vec<u8> = (0..400u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let (started, mut sent) = (Instant::now(), 0usize);
    while !over.load(Ordering::Relaxed) {
        let due = (started.elapsed().as_secs_f64() * f64::from(per_s)) as usize;
        for number in sent..due {
            let sender = if number % 2 == 0 { "forger-0".to_owned() } else { format!("forger-{number}") };
            let put = session.put(format!("flockslam/{flock}/to/{victim}/{sender}"), rubbish.clone());
            put.congestion_control(zenoh::qos::CongestionControl::Block).wait().unwrap();
        }
        sent = sent.max(due);
        std::thread::sleep(Duration::from_millis(1));
    }
    sent
}

/// Somebody on the robot's network who is none of its flock.
fn outside_session(robot: &FlockRobot) -> zenoh::Session {
    let mut configuration = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"peer\"".to_owned()),
        ("connect/endpoints", format!("[{:?}]", robot.endpoint)),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        configuration.insert_json5(key, &value).unwrap();
    }
    zenoh::open(configuration).wait().unwrap()
}

/// Sends a robot whatever may hurt it – random bytes, giant claims, builds of the future, replays of its own messages bent a little, and
/// all of it `flood` times over as fast as it goes; gives how many messages that were.
pub fn hostile(robot: &FlockRobot, flood: usize) -> usize {
    let victim = robot.address();
    let flock = robot.flock().unwrap().flock;
    let session = outside_session(robot);
    let prefix = format!("flockslam/{flock}");
    let received: Arc<Mutex<Vec<Vec<u8>>>> = Arc::default();
    let keep = Arc::clone(&received);
    let receive = move |sample: zenoh::sample::Sample| {
        keep.lock().unwrap().push(sample.payload().to_bytes().into_owned());
    };
    let _subscriber =
        session.declare_subscriber(format!("{prefix}/to/forger-0/*")).callback(receive).wait().unwrap();
    let _there = session.liveliness().declare_token(format!("{prefix}/there/forger-0")).wait().unwrap();
    let mut sent = 0;
    let mut send = |sender: &str, bytes: Vec<u8>| {
        let put = session.put(format!("{prefix}/to/{victim}/{sender}"), bytes);
        put.congestion_control(zenoh::qos::CongestionControl::Block).wait().unwrap();
        sent += 1;
    };
    // The robot answers every request: it is sent its own records back, altered.
    let asked = wait_for("records of the victim", || {
        send("forger-0", Message::Have(Vector::default()).encode());
        std::thread::sleep(std::time::Duration::from_millis(100));
        let received = received.lock().unwrap();
        received.iter().find_map(|bytes| match Message::decode(bytes) {
            Ok(Message::Records(records)) => Some(records),
            _ => None,
        })
    });
    let short = asked.iter().min_by_key(|record| record.len()).unwrap();
    let bent = |place: usize| {
        let mut record = short.to_vec();
        let at = place % record.len();
        record[at] ^= 0x10;
        Arc::<[u8]>::from(record)
    };
    let forger = RobotKey::of_replay("forger").unwrap();
    let giant = Content::Withdrawal(Withdrawal { epoch: u64::MAX, number: u64::MAX });
    let signed = Record::new(&forger, 1, 0, &giant).unwrap().bytes().clone();
    let mut future = Message::Have(Vector::default()).encode();
    future[4] = 99;
    let mut noise = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = |length: usize| -> Vec<u8> {
        let mut next = || {
            noise ^= noise << 13;
            noise ^= noise >> 7;
            noise ^= noise << 17;
            noise as u8
        };
        (0..length).map(|_| next()).collect()
    };
    let claims = [&b"FLMS\x01\x02"[..], &[0xff; 9], &[0x01]].concat();
    let mut kinds = vec![
        random(100),
        random(60_000),
        future,
        claims,
        Message::Records(vec![signed]).encode(),
        Message::Records((0..64).map(bent).collect()).encode(),
        Message::Records(asked.clone()).encode(),
    ];
    kinds.push(random(MESSAGE_BYTES_MAX + 1000));
    for kind in &kinds {
        send("forger-0", kind.clone());
        std::thread::sleep(std::time::Duration::from_millis(30));
    }
    kinds.truncate(5);
    for number in 0..flood {
        // Now under its own name, now under one that nobody knows.
        let sender = if number % 2 == 0 { "forger-0".to_owned() } else { format!("forger-{number}") };
        send(&sender, kinds[number % kinds.len()].clone());
    }
    sent
}
