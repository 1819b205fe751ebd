//! `flockslam swarm`: several robots map together.

use super::join::{join, run_member};
use super::meetings::meet;
use super::run::prepare_directory;
use super::{CommandError, say};
use crate::cli::{ProtocolArg, SwarmArgs};
use crate::configuration::Configuration;
use flockslam_geometry::Pose;
use flockslam_lidar_ingest::Settings;
use flockslam_lidar_ingest::carmen::{CarmenReader, write_scan};
use flockslam_messages::ScanBuffer;
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

/// How far a robot's odometry is moved away at most, metres.
const MOVED_M: f64 = 100.0;

/// Runs the command.
///
/// # Errors
/// When the log, the configuration or the directory is not usable, or a set fails.
pub fn run(args: &SwarmArgs) -> Result<(), CommandError> {
    let given = &args.configuration;
    let configuration = Configuration::load(given.profile, given.config.as_deref(), &given.assignments)?;
    prepare_directory(&args.out)?;
    let spans = cut(args, &configuration.lidar_ingest)?;
    let mut members = Vec::new();
    for (number, log) in (1..).zip(spans) {
        let name = format!("r{number:02}");
        let command = ["map".as_ref(), log.as_os_str()];
        members.push(run_member(&command, given, &name, &args.out.join(&name))?);
    }
    if args.protocol == ProtocolArg::Meeting {
        say(&meet(&args.out, given, &members, args.fusion)?.summary(&args.out));
        return Ok(());
    }
    let joined = join(&args.out, given, members)?;
    say(&joined.summary(&args.out));
    if joined.all_agree {
        Ok(())
    } else {
        Err(CommandError::failed("robots with the same records have different maps"))
    }
}

/// Cuts the log into equal spans of time, a file for each robot, with the odometry of each moved by a motion of its own.
fn cut(args: &SwarmArgs, settings: &Settings) -> Result<Vec<PathBuf>, CommandError> {
    let (mut first_ns, mut last_ns) = (i64::MAX, i64::MIN);
    read(&args.log, settings, |scan| {
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
    read(&args.log, settings, |scan| {
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
