//! What one meeting is worth: two robots drive a hundred metres through the simulated building, exchange what they have recorded
//! once, in the middle, and go on. Prints the error of each robot's pose as it was known at the time, with and without that.
//!
//! `cargo run --release --example one_meeting -- [FLOCKSLAM] [SEEDS]`: the executable that drives the robots (default
//! `target/release/flockslam`), and how many seeds (default 10).

use flockslam::evaluation::{evaluate_truth, parse_tum};
use flockslam::outputs::TrajectoryPoint;
use flockslam_geometry::Pose;
use flockslam_records::{Content, Limits, Record, RobotKey};
use flockslam_stage::flock_files::{OWN_SCANS, RecordLog, read_named};
use flockslam_sync_manager::Settings;
use flockslam_sync_manager::flock::{Flock, FlockLayout};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// How long each robot drives, seconds: some hundred metres.
const DRIVE_S: f64 = 160.0;
/// Epoch of the records of a run.
const EPOCH: u64 = 1;
/// Searches for shared places after each of a robot's own submaps.
const SEARCHES: u64 = 60;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let flockslam = PathBuf::from(arguments.next().unwrap_or_else(|| "target/release/flockslam".into()));
    let seeds: u64 = arguments.next().map_or(Ok(10), |seeds| seeds.parse())?;
    println!("seed  driven m  with one meeting m  without m  as the set published it m");
    let (mut worst_m, mut better) = (0.0f64, 0);
    for seed in 1..=seeds {
        let directory = tempfile::tempdir()?;
        drive(&flockslam, seed, directory.path())?;
        let robots = [Robot::read(directory.path(), "r01")?, Robot::read(directory.path(), "r02")?];
        let [with_m, without_m, published_m] = errors_m(&robots)?;
        println!(
            "{seed:4} {:9.0} {with_m:19.4} {without_m:10.4} {published_m:26.4}",
            robots[0].driven_m() + robots[1].driven_m()
        );
        worst_m = worst_m.max(with_m);
        better += u32::from(with_m < without_m);
    }
    println!("worst {worst_m:.4} m; better than without in {better} of {seeds}");
    Ok(())
}

/// Lets two robots drive alone.
fn drive(flockslam: &Path, seed: u64, out: &Path) -> Result<()> {
    let mut command = Command::new(flockslam);
    command.args(["swarm", "--robots", "2", "--out"]).arg(out);
    command.args(["--set", &format!("simulation.seed={}", 100 * seed)]);
    command.args(["--set", &format!("simulation.duration_s={DRIVE_S:?}")]);
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status()?;
    if status.success() {
        Ok(())
    } else {
        Err(format!("{} has failed: {status}", flockslam.display()).into())
    }
}

/// Root mean square errors of the poses known at the time, both robots, metres: with the meeting, without it, and as the sets published them.
fn errors_m(robots: &[Robot; 2]) -> Result<[f64; 3]> {
    let mut squares = [0.0; 3];
    for (own, other) in [(&robots[0], &robots[1]), (&robots[1], &robots[0])] {
        let ways = [own.online(Some(other))?, own.online(None)?, own.published.clone()];
        for (sum, way) in squares.iter_mut().zip(ways) {
            let report = evaluate_truth(&way, &own.truth)?;
            let spread = report.absolute.translation_m.ok_or("no pose has a true one")?;
            *sum += spread.rmse * spread.rmse / 2.0;
        }
    }
    Ok(squares.map(f64::sqrt))
}

/// What a robot has left of its drive.
struct Robot {
    name: &'static str,
    records: Vec<Vec<u8>>,
    /// Sequence of the scan of each stamp.
    sequences: BTreeMap<i64, u64>,
    /// Its poses as the set published them.
    published: Vec<TrajectoryPoint>,
    truth: Vec<TrajectoryPoint>,
}

impl Robot {
    fn read(out: &Path, name: &'static str) -> Result<Self> {
        let directory = out.join(name);
        let poses = |file: &str| -> Result<Vec<TrajectoryPoint>> {
            Ok(parse_tum(file, &std::fs::read(directory.join(file))?)?)
        };
        let scans = read_named(&directory, OWN_SCANS)?;
        Ok(Self {
            name,
            records: RecordLog::read(&directory)?,
            sequences: scans.iter().map(|scan| (scan.stamp_ns, scan.sequence)).collect(),
            published: poses("trajectory_online.tum")?,
            truth: poses("truth.tum")?,
        })
    }

    fn driven_m(&self) -> f64 {
        self.truth.windows(2).map(|pair| pair[0].map_from_base.distance_m(pair[1].map_from_base)).sum()
    }

    fn flock(&self) -> Result<Flock> {
        let key = RobotKey::of_replay(self.name)?;
        Ok(Flock::new(key, EPOCH, Settings::default(), Limits::default()))
    }

    /// Its records in the order in which it told them, each with the sequence of the newest scan that it knew then.
    fn told(&self) -> Result<Vec<(u64, &[u8])>> {
        let mut newest = 0;
        let mut told = Vec::new();
        for bytes in &self.records {
            if let Content::Stretch(stretch) = &Record::read(bytes)?.content {
                newest = stretch.nodes.last().map_or(newest, |node| node.sequence);
            }
            told.push((newest, &bytes[..]));
        }
        Ok(told)
    }

    /// Its pose at each scan as its flock knew it at the time, in the robot's own frame, when it has met this one in the middle of the drive: from
    /// the newest node on by the front end.
    fn online(&self, met: Option<&Robot>) -> Result<Vec<TrajectoryPoint>> {
        let middle = self.published.len() as u64 / 2;
        let mut flock = self.flock()?;
        let mut meets = met;
        let mut told = self.told()?.into_iter().peekable();
        let mut newest: Option<(u64, Pose)> = None;
        let mut way = Vec::with_capacity(self.published.len());
        let by_sequence = self.published_by_sequence();
        for point in &self.published {
            let Some(&sequence) = self.sequences.get(&point.stamp_ns) else { continue };
            let mut news = false;
            while let Some((_, bytes)) = told.next_if(|(newest, _)| *newest < sequence) {
                flock.collection_mut().take(bytes)?;
                news = true;
            }
            if sequence >= middle
                && let Some(other) = meets.take()
            {
                for (_, bytes) in other.told()?.into_iter().filter(|(newest, _)| *newest < middle) {
                    flock.collection_mut().take(bytes)?;
                }
                flock.search(u64::MAX)?;
                news = true;
            }
            if news {
                if met.is_some() && meets.is_none() {
                    flock.search(SEARCHES)?;
                }
                newest = self.newest(&flock.layout(false));
            }
            let known = newest.and_then(|(node, at)| {
                let then = by_sequence.get(&node)?;
                Some(at * then.inverse() * point.map_from_base)
            });
            way.push(TrajectoryPoint { map_from_base: known.unwrap_or(point.map_from_base), ..*point });
        }
        Ok(way)
    }

    fn published_by_sequence(&self) -> BTreeMap<u64, Pose> {
        let named =
            |point: &TrajectoryPoint| Some((*self.sequences.get(&point.stamp_ns)?, point.map_from_base));
        self.published.iter().filter_map(named).collect()
    }

    /// The newest node and its pose, where the first one is the robot's start.
    fn newest(&self, layout: &FlockLayout) -> Option<(u64, Pose)> {
        let nodes = layout.nodes.iter().find(|((robot, _), _)| robot.name() == self.name)?.1;
        let (first, last) = (nodes.first()?, nodes.last()?);
        let start = self.published_by_sequence().get(&first.sequence).copied()?;
        Some((last.sequence, start * first.flock_from_base.inverse() * last.flock_from_base))
    }
}
