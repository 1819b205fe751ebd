//! What one meeting is worth: two robots drive a hundred metres through the simulated building, exchange what they have recorded
//! once, in the middle, and go on. Prints the error of each robot's pose as it was known at the time, with and without that.
//!
//! `cargo bench -p flockslam --bench one_meeting -- [SEEDS] [SECTION.KEY=VALUE …]`: how many seeds (default 10), and settings of the
//! drives.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

use flockslam::evaluation::{evaluate_truth, parse_tum};
use flockslam::outputs::TrajectoryPoint;
use flockslam_flock::{Flock, FlockSolution};
use flockslam_geometry::Pose;
use flockslam_records::{Content, Limits, Record, RobotKey};
use flockslam_results::flock_files::{OWN_SCANS, RecordLog, read_named};
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
    // Cargo adds an option of its own.
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let flockslam = PathBuf::from(env!("CARGO_BIN_EXE_flockslam"));
    let seeds: u64 = arguments.next().map_or(Ok(10), |seeds| seeds.parse())?;
    let settings: Vec<String> = arguments.collect();
    println!("seed  driven m  with one meeting m  without m  as the set published it m");
    let (mut worst_m, mut better) = (0.0f64, 0);
    for seed in 1..=seeds {
        let directory = tempfile::tempdir()?;
        drive(&flockslam, seed, &settings, directory.path())?;
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
fn drive(flockslam: &Path, seed: u64, settings: &[String], out: &Path) -> Result<()> {
    let mut command = Command::new(flockslam);
    command.args(["swarm", "--robots", "2", "--out"]).arg(out);
    command.args(["--set", &format!("simulation.seed={}", 100 * seed)]);
    command.args(["--set", &format!("simulation.duration_s={DRIVE_S:?}")]);
    for setting in settings {
        command.args(["--set", setting]);
    }
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
    /// Poses of its nodes by the front end alone, which never jumps.
    odometry: BTreeMap<u64, Pose>,
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
        let records = RecordLog::read(&directory)?;
        let mut odometry = BTreeMap::new();
        for bytes in &records {
            if let Content::Stretch(stretch) = &Record::read(bytes)?.content {
                odometry.extend(stretch.nodes.iter().map(|node| (node.sequence, node.odom_from_base)));
            }
        }
        Ok(Self {
            name,
            records,
            odometry,
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
        Ok(Flock::new(key, EPOCH, Limits::default()))
    }

    /// Its records in the order of publication, each with the sequence of the newest scan that it knew then.
    fn published(&self) -> Result<Vec<(u64, &[u8])>> {
        let mut newest = 0;
        let mut published = Vec::new();
        for bytes in &self.records {
            if let Content::Stretch(stretch) = &Record::read(bytes)?.content {
                newest = stretch.nodes.last().map_or(newest, |node| node.sequence);
            }
            published.push((newest, &bytes[..]));
        }
        Ok(published)
    }

    /// Its pose at each scan as its flock knew it at the time, in the robot's own frame, when it has met this one in the middle of the drive: from
    /// the newest node on by the front end.
    fn online(&self, met: Option<&Robot>) -> Result<Vec<TrajectoryPoint>> {
        let middle = self.published.len() as u64 / 2;
        let mut flock = self.flock()?;
        let mut meets = met;
        let mut published = self.published()?.into_iter().peekable();
        let mut newest: Option<(u64, Pose)> = None;
        let mut seen = BTreeMap::new();
        let mut way = Vec::with_capacity(self.published.len());
        let by_sequence = self.published_by_sequence();
        for point in &self.published {
            let Some(&sequence) = self.sequences.get(&point.stamp_ns) else { continue };
            let mut has_new = false;
            while let Some((_, bytes)) = published.next_if(|(newest, _)| *newest < sequence) {
                // Said anew, among what it says of the other robot.
                flock.record(&Record::read(bytes)?.content)?;
                has_new = true;
            }
            if sequence >= middle
                && let Some(other) = meets.take()
            {
                for (_, bytes) in other.published()?.into_iter().filter(|(newest, _)| *newest < middle) {
                    flock.collection_mut().take(bytes)?;
                }
                flock.search(u64::MAX)?;
                has_new = true;
            }
            if has_new {
                if met.is_some() && meets.is_none() {
                    flock.search(SEARCHES)?;
                }
                newest = self.newest(&flock.solution(false), &mut seen);
            }
            let known = newest.and_then(|(node, at)| {
                // By the front end to the last node, which is not published yet, and from there as published: nothing jumps between.
                let (last, here) = self.odometry.range(..=sequence).next_back()?;
                let moved = self.odometry.get(&node)?.inverse() * *here;
                Some(at * moved * by_sequence.get(last)?.inverse() * point.map_from_base)
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

    /// The newest node and its pose, in the robot's own frame: that in which its nodes lie nearest to where they lay when they were new, which
    /// `seen` remembers.
    fn newest(&self, solution: &FlockSolution, seen: &mut BTreeMap<u64, Pose>) -> Option<(u64, Pose)> {
        let nodes = solution.nodes.iter().find(|((robot, _), _)| robot.name() == self.name)?.1;
        let last = nodes.last()?;
        let pairs: Vec<(Pose, Pose)> =
            nodes.iter().filter_map(|n| Some((n.flock_from_base, *seen.get(&n.sequence)?))).collect();
        let own_from_flock = if pairs.is_empty() {
            *self.published_by_sequence().get(&nodes[0].sequence)? * nodes[0].flock_from_base.inverse()
        } else {
            aligned(&pairs)
        };
        for node in nodes {
            seen.entry(node.sequence).or_insert(own_from_flock * node.flock_from_base);
        }
        Some((last.sequence, own_from_flock * last.flock_from_base))
    }
}

/// What takes the first poses nearest to the second: least squares of their positions.
fn aligned(pairs: &[(Pose, Pose)]) -> Pose {
    let share = 1.0 / pairs.len() as f64;
    let mean = |pick: fn(&(Pose, Pose)) -> Pose| {
        let sum = pairs.iter().map(pick).fold((0.0, 0.0), |sum, pose| (sum.0 + pose.x_m, sum.1 + pose.y_m));
        (sum.0 * share, sum.1 * share)
    };
    let (from, to) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let (mut dot, mut cross) = (0.0, 0.0);
    for (a, b) in pairs {
        let (ax, ay, bx, by) = (a.x_m - from.0, a.y_m - from.1, b.x_m - to.0, b.y_m - to.1);
        dot += ax * bx + ay * by;
        cross += ax * by - ay * bx;
    }
    let turn =
        if pairs.len() < 2 { pairs[0].1.heading_rad - pairs[0].0.heading_rad } else { cross.atan2(dot) };
    let (sin, cos) = turn.sin_cos();
    Pose::new(to.0 - cos * from.0 + sin * from.1, to.1 - sin * from.0 - cos * from.1, turn)
}
