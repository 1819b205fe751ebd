//! `flockslam swarm`: several robots map together.

use super::contacts::Contacts;
use super::joined_map::{Member, Order, join, join_met};
use super::meetings::meet;
use super::run::prepare_directory;
use super::{CommandError, print};
use crate::arguments::{ConfigurationArgs, ProtocolArg, SwarmArgs};
use crate::configuration::Configuration;
use flockslam_geometry::Pose;
use flockslam_lidar_ingest::Settings;
use flockslam_lidar_ingest::carmen::{CarmenReader, write_scan};
use flockslam_messages::ScanBuffer;
use flockslam_simulation::Settings as Simulation;
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::Duration;

/// How far a robot's odometry is moved away at most, metres.
const MOVED_M: f64 = 100.0;

/// In the simulated building each robot is ahead of the one before it by this share of the whole drive.
const LEAD: f64 = 0.5;
/// How long robots that have ended wait for the others, seconds: a search may be under way.
const WAIT_MAX_S: u32 = 600;
/// The robots are looked at this often.
const LOOK: Duration = Duration::from_millis(50);

/// Runs the command.
///
/// # Errors
/// When the log, the configuration or the directory is not usable, or a set fails.
pub fn run(args: &SwarmArgs) -> Result<(), CommandError> {
    let given = &args.configuration;
    let configuration = Configuration::load(given.profile, given.config.as_deref(), &given.assignments)?;
    prepare_directory(&args.out)?;
    let robots = match &args.log {
        Some(log) => {
            let spans = cut(args, log, &configuration.lidar_ingest)?;
            spans.into_iter().map(|log| vec!["map".into(), log.into_os_string()]).collect()
        }
        None => vec![vec![OsString::from("demo")]; args.robots as usize],
    };
    let mut robots: Vec<Robot> = (1..)
        .zip(robots)
        .map(|(number, command)| Robot::new(args, &configuration, number, command))
        .collect();
    let joined = match args.rate {
        None => {
            let members: Result<Vec<_>, _> =
                robots.iter().map(|robot| robot.order(|o| o.run(given))).collect();
            let members = members?;
            if args.protocol == ProtocolArg::Meeting {
                print(&meet(&args.out, &members, args.fusion)?.summary(&args.out));
                return Ok(());
            }
            join(&args.out, members)?
        }
        Some(rate) => {
            connect(&mut robots, rate)?;
            let contacts = args.range.map(|range_m| meet_within(&mut robots, range_m));
            let members = run_at_once(&robots, given, contacts.transpose()?.as_ref())?;
            join_met(&args.out, members)?
        }
    };
    print(&joined.summary(&args.out));
    if joined.all_agree {
        Ok(())
    } else {
        Err(CommandError::failed("robots with the same records have different maps"))
    }
}

/// Lets the robots talk only while they are within range of each other and see each other.
fn meet_within(robots: &mut [Robot], range_m: f64) -> Result<Contacts, CommandError> {
    let simulated = |robot: &Robot| (robot.name.clone(), robot.set(), robot.drive.clone());
    let contacts = Contacts::new(&robots.iter().map(simulated).collect::<Vec<_>>(), range_m)?;
    let proximity = || "sync_manager.flock.proximity=contacts".to_owned();
    robots.iter_mut().for_each(|robot| robot.assignments.push(proximity()));
    Ok(contacts)
}

/// A robot that is to run.
struct Robot {
    name: String,
    /// Its drive through the simulated building.
    drive: Simulation,
    command: Vec<OsString>,
    assignments: Vec<String>,
    out: PathBuf,
}

impl Robot {
    fn new(args: &SwarmArgs, configuration: &Configuration, number: u32, command: Vec<OsString>) -> Self {
        let name = format!("r{number:02}");
        let out = args.out.join(&name);
        // All drive the same tour, so that they come through the same places: the next one begins half a drive ahead.
        let mut drive = configuration.simulation.clone();
        drive.seed += u64::from(number) - 1;
        drive.lead_s += LEAD * drive.duration_s * f64::from(number - 1);
        let mut robot = Self { name, drive, command, assignments: Vec::new(), out };
        if args.log.is_none() {
            // Each drives its own way, and its odometry begins somewhere else.
            let Pose { x_m, y_m, heading_rad } = moved(args.seed, number);
            robot.assignments.push(format!("simulation.seed={}", robot.drive.seed));
            robot.assignments.push(format!("simulation.lead_s={:?}", robot.drive.lead_s));
            robot.assignments.push(format!("lidar_ingest.start_pose=[{x_m:?}, {y_m:?}, {heading_rad:?}]"));
        }
        robot
    }

    /// Name of its process set.
    fn set(&self) -> String {
        format!("swarm-{}-{}", std::process::id(), self.name)
    }

    fn order<T>(&self, carry_out: impl FnOnce(&Order<'_>) -> T) -> T {
        let command: Vec<&OsStr> = self.command.iter().map(OsString::as_os_str).collect();
        let order =
            Order { name: &self.name, command: &command, assignments: &self.assignments, out: &self.out };
        carry_out(&order)
    }
}

/// Lets the robots run live, reach each other on this machine, and stay until all have ended.
fn connect(robots: &mut [Robot], rate: f64) -> Result<(), CommandError> {
    // Held all at once, so that they are different.
    let held: Result<Vec<TcpListener>, _> =
        robots.iter().map(|_| TcpListener::bind(("127.0.0.1", 0))).collect();
    let ports: Result<Vec<u16>, _> = held
        .map_err(CommandError::failed)?
        .iter()
        .map(|listener| Ok(listener.local_addr()?.port()))
        .collect();
    let ports = ports.map_err(|e: std::io::Error| CommandError::failed(e))?;
    let endpoint = |port: &u16| format!("tcp/127.0.0.1:{port}");
    let other_count = robots.len() - 1;
    for (number, robot) in robots.iter_mut().enumerate() {
        let others: Vec<String> = ports[..number].iter().map(endpoint).collect();
        let set = robot.set();
        robot.command.extend(["--rate".into(), rate.to_string().into(), "--robot".into(), set.into()]);
        let flock = [
            "enabled=true".to_owned(),
            format!("flock=\"swarm-{}\"", std::process::id()),
            format!("listen={:?}", [endpoint(&ports[number])]),
            format!("connect={others:?}"),
            format!("wait_for_robots={other_count}"),
            format!("wait_max_s={WAIT_MAX_S}"),
        ];
        robot.assignments.extend(flock.map(|assignment| format!("sync_manager.flock.{assignment}")));
    }
    Ok(())
}

/// Runs all robots at once; when one fails, the others are ended.
fn run_at_once(
    robots: &[Robot],
    given: &ConfigurationArgs,
    contacts: Option<&Contacts>,
) -> Result<Vec<Member>, CommandError> {
    let mut children = Children(Vec::new());
    for robot in robots {
        children.0.push((robot.order(|order| order.start(given))?, None));
    }
    while children.0.iter().any(|(_, ended)| ended.is_none()) {
        std::thread::sleep(LOOK);
        contacts.into_iter().for_each(Contacts::report);
        for (robot, (child, ended)) in robots.iter().zip(&mut children.0).filter(|(_, (_, e))| e.is_none()) {
            if let Some(status) = child.try_wait().map_err(CommandError::failed)? {
                *ended = Some(robot.order(|order| order.recorded(status))?);
            }
        }
    }
    Ok(children.0.drain(..).filter_map(|(_, member)| member).collect())
}

/// Supervisors that are killed when this is dropped; their stages go with them.
struct Children(Vec<(Child, Option<Member>)>);

impl Drop for Children {
    fn drop(&mut self) {
        for (child, _) in self.0.iter_mut().filter(|(_, ended)| ended.is_none()) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Cuts the log into equal spans of time, a file for each robot, with the odometry of each moved by a motion of its own.
fn cut(args: &SwarmArgs, log: &Path, settings: &Settings) -> Result<Vec<PathBuf>, CommandError> {
    let (mut first_ns, mut last_ns) = (i64::MAX, i64::MIN);
    read(log, settings, |scan| {
        let stamp_ns = scan.header.times.sensor_ns;
        (first_ns, last_ns) = (first_ns.min(stamp_ns), last_ns.max(stamp_ns));
        Ok(())
    })?;
    let span_ns = last_ns.saturating_sub(first_ns).max(0) as u64 / u64::from(args.robots) + 1;
    let mut parts = Vec::new();
    for number in 1..=args.robots {
        let directory = args.out.join(format!("r{number:02}"));
        prepare_directory(&directory)?;
        let path = directory.join("log.clf");
        let file = File::create(&path).map_err(|e| wrong(&path, e))?;
        parts.push(Part { path, file: BufWriter::new(file), moved: moved(args.seed, number), scans: 0 });
    }
    // Stamps of logs run backwards now and then: the order of lines decides where a robot takes over.
    let mut current = 0;
    read(log, settings, |scan| {
        let place = (scan.header.times.sensor_ns.abs_diff(first_ns) / span_ns) as usize;
        current = place.min(parts.len() - 1).max(current);
        parts[current].write(scan)
    })?;
    if let Some(empty) = parts.iter().position(|part| part.scans == 0) {
        return Err(CommandError::user(format!("robot {} of {} has no scan", empty + 1, args.robots)));
    }
    let finish = |mut part: Part| {
        part.file.flush().map_err(|e| wrong(&part.path, e))?;
        Ok(part.path)
    };
    parts.into_iter().map(finish).collect()
}

/// One robot's span of the log.
struct Part {
    path: PathBuf,
    file: BufWriter<File>,
    moved: Pose,
    scans: u64,
}

impl Part {
    fn write(&mut self, scan: &mut ScanBuffer) -> Result<(), CommandError> {
        scan.header.odometry = self.moved * scan.header.odometry;
        let view = scan.view().map_err(CommandError::failed)?;
        write_scan(&mut self.file, view).map_err(|e| wrong(&self.path, e))?;
        self.scans += 1;
        Ok(())
    }
}

fn read(
    log: &Path,
    settings: &Settings,
    mut each: impl FnMut(&mut ScanBuffer) -> Result<(), CommandError>,
) -> Result<(), CommandError> {
    let file = File::open(log).map_err(|e| CommandError::user(format!("{}: {e}", log.display())))?;
    let name = log.display().to_string();
    let mut reader = CarmenReader::new(BufReader::new(file), name, settings.clone());
    let mut scan = ScanBuffer::default();
    while reader.next_scan(&mut scan).map_err(CommandError::user)? {
        each(&mut scan)?;
    }
    Ok(())
}

/// A motion that follows from seed and robot.
fn moved(seed: u64, robot: u32) -> Pose {
    let hash = blake3::hash(&[&seed.to_le_bytes()[..], &robot.to_le_bytes()].concat());
    let unit = |at: usize| {
        let bytes: [u8; 4] = hash.as_bytes()[at..at + 4].try_into().expect("four bytes");
        f64::from(u32::from_le_bytes(bytes)) / f64::from(u32::MAX) * 2.0 - 1.0
    };
    Pose::new(MOVED_M * unit(0), MOVED_M * unit(4), std::f64::consts::PI * unit(8))
}

fn wrong(path: &Path, error: std::io::Error) -> CommandError {
    CommandError::failed(format!("{}: {error}", path.display()))
}
