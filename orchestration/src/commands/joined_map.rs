//! Robots that have mapped for themselves meet: they exchange what they have recorded, find out how they lie to each other, and
//! each works out the same map.

use super::CommandError;
use super::run::occupancy;
use crate::arguments::ConfigurationArgs;
use crate::outputs::{TrajectoryPoint, map_hash, write_flock_picture, write_map, write_trajectory};
use clap::ValueEnum;
use flockslam_geometry::Pose;
use flockslam_journal::{Durability, replace_file};
use flockslam_map_fusion::FusedMap;
use flockslam_map_fusion::stored_map;
use flockslam_records::{Limits, Message, RobotKey};

use flockslam_flock::{Flock, FlockSolution, OwnPose, in_flock_frame};
use flockslam_results::FlockStatus;
use flockslam_results::StoredMap;
use flockslam_results::flock_files::{NamedPose, OWN_NODES, OWN_SCANS, RecordLog, read_named};
use flockslam_stage::StageError;
use serde::Serialize;
use std::ffi::OsStr;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Instant;

/// Records that a robot sends in answer to one message, bytes.
const ANSWER_BYTES: usize = 4 << 20;
/// Epoch of the records of a run.
const EPOCH: u64 = 1;

/// What a robot has recorded for its flock, and what it knows of its own way.
pub struct Member {
    name: String,
    records: Vec<Vec<u8>>,
    scans: Vec<OwnPose>,
    nodes: Vec<(u64, Pose)>,
    /// Its last status of the flock, when it was in one.
    status: Option<FlockStatus>,
}

impl Member {
    /// The robot's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Reads what a robot's sync-manager has left in a directory.
    ///
    /// # Errors
    /// When it is not there.
    pub fn read(name: &str, directory: &Path) -> Result<Self, StageError> {
        let scan = |row: NamedPose| OwnPose {
            sequence: row.sequence,
            stamp_ns: row.stamp_ns,
            map_from_base: row.pose,
        };
        Ok(Self {
            name: name.to_owned(),
            status: FlockStatus::read(directory),
            records: RecordLog::read(directory)?,
            scans: read_named(directory, OWN_SCANS)?.into_iter().map(scan).collect(),
            nodes: read_named(directory, OWN_NODES)?
                .into_iter()
                .map(|row| (row.sequence, row.pose))
                .collect(),
        })
    }
}

/// A robot that is to run as a process set of its own.
pub struct Order<'a> {
    /// Its name in the flock.
    pub name: &'a str,
    /// The command that it runs, without outputs and configuration.
    pub command: &'a [&'a OsStr],
    /// What it is configured with beside what the user gave.
    pub assignments: &'a [String],
    /// Where its outputs go.
    pub out: &'a Path,
}

impl Order<'_> {
    /// Starts the robot as a supervisor of its own: what it says goes to the standard error.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn start(&self, given: &ConfigurationArgs) -> Result<Child, CommandError> {
        let program = std::env::current_exe().map_err(CommandError::failed)?;
        let mut child = Command::new(program);
        child.args(self.command).arg("--out").arg(self.out);
        if let Some(config) = &given.config {
            child.arg("--config").arg(config);
        }
        if let Some(profile) = given.profile.to_possible_value() {
            child.args(["--profile", profile.get_name()]);
        }
        let name = format!("sync_manager.flock.name=\"{}\"", self.name);
        for assignment in given.assignments.iter().chain(self.assignments).chain([&name]) {
            child.args(["--set", assignment]);
        }
        child.stdout(Stdio::null()).spawn().map_err(CommandError::failed)
    }

    /// What a robot has recorded that has ended.
    ///
    /// # Errors
    /// When it has failed.
    pub fn recorded(&self, status: ExitStatus) -> Result<Member, CommandError> {
        let name = self.name;
        match status.code() {
            Some(0) => Member::read(name, self.out).map_err(CommandError::failed),
            Some(2) => Err(CommandError::user(format!("robot {name} cannot run"))),
            _ => Err(CommandError::failed(format!("robot {name} has failed ({status})"))),
        }
    }

    /// Runs the robot to its end and gives what it has recorded.
    ///
    /// # Errors
    /// When it fails.
    pub fn run(&self, given: &ConfigurationArgs) -> Result<Member, CommandError> {
        let status = self.start(given)?.wait().map_err(CommandError::failed)?;
        self.recorded(status)
    }
}

/// What became of a meeting, as written to `flock.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Joined {
    /// Names of all robots, in order.
    pub robots: Vec<String>,
    /// Those that are part of the common map.
    pub members: Vec<String>,
    /// Whether every robot has worked out the same solution and the same map.
    pub all_agree: bool,
    /// Hash of the solution.
    pub solution_hash: String,
    /// Hash of the fused map.
    pub map_hash: String,
    /// Hash of the records that all have.
    pub records_hash: String,
    /// Constraints between robots that act, and those that do not.
    pub constraints_between: (u64, u64),
    /// Branch-and-bound searches of all robots.
    pub searches: u64,
    /// Records, and their bytes.
    pub records: (u64, u64),
    /// Bytes that travelled between the robots.
    pub bytes_exchanged: u64,
    /// Time that looking for each other took, all robots together, seconds; 0 when they met while they drove.
    pub search_s: f64,
    /// Time of one final solution, seconds.
    pub solution_s: f64,
}

impl Joined {
    /// For people.
    pub fn summary(&self, out: &Path) -> String {
        let agree = if self.all_agree { "all robots have the same map" } else { "THE MAPS DIFFER" };
        format!(
            "{} of {} robots in one map: {}\n{} constraints between robots act, {} do not; {} records, {:.0} kB; {agree}\n\
             map {}\nwrote trajectory.tum, map.pgm, map.yaml, map.png, flock.json to {}\n",
            self.members.len(),
            self.robots.len(),
            self.members.join(", "),
            self.constraints_between.0,
            self.constraints_between.1,
            self.records.0,
            self.records.1 as f64 * 1e-3,
            self.map_hash,
            out.display()
        )
    }
}

/// Lets the robots meet, and writes what they find into a directory.
///
/// # Errors
/// When the disk refuses.
pub fn join(out: &Path, members: Vec<Member>) -> Result<Joined, CommandError> {
    let mut flocks = flocks(&members)?;
    let mut met = Met { bytes_exchanged: exchange(&mut flocks), ..Met::default() };
    for k in 0..flocks.len() {
        let started = Instant::now();
        flocks[k].search(u64::MAX).map_err(CommandError::failed)?;
        met.search_s += started.elapsed().as_secs_f64();
        // What one has found, the others need not look for.
        met.bytes_exchanged += exchange(&mut flocks);
    }
    met.searches = flocks.iter().map(Flock::searches).sum();
    conclude(out, &members, &flocks, &met)
}

/// As [`join`], of robots that have met while they drove: each knows the records of all.
///
/// # Errors
/// When a robot has left no status, or the disk refuses.
pub fn join_met(out: &Path, members: Vec<Member>) -> Result<Joined, CommandError> {
    let statuses: Option<Vec<&FlockStatus>> = members.iter().map(|member| member.status.as_ref()).collect();
    let statuses = statuses.ok_or_else(|| CommandError::failed("a robot has left no status of its flock"))?;
    let same = |status: &&FlockStatus| status.converged && status.map_hash == statuses[0].map_hash;
    let met = Met {
        bytes_exchanged: statuses.iter().map(|status| status.said_bytes).sum(),
        searches: statuses.iter().map(|status| status.searches).sum(),
        search_s: 0.0,
        differ: !statuses.iter().all(same),
    };
    let flocks = flocks(&members)?;
    conclude(out, &members, &flocks, &met)
}

/// How the robots came together.
#[derive(Default)]
struct Met {
    bytes_exchanged: u64,
    searches: u64,
    search_s: f64,
    /// The robots themselves have concluded different things.
    differ: bool,
}

/// What each robot knows.
fn flocks(members: &[Member]) -> Result<Vec<Flock>, CommandError> {
    members.iter().map(alone).collect()
}

/// Lets each robot work out the common map, compares them, and writes it into a directory.
fn conclude(out: &Path, members: &[Member], flocks: &[Flock], met: &Met) -> Result<Joined, CommandError> {
    let started = Instant::now();
    let solutions: Vec<FlockSolution> = flocks.iter().map(|flock| flock.solution(true)).collect();
    let solution_s = started.elapsed().as_secs_f64() / flocks.len().max(1) as f64;
    let maps: Vec<StoredMap> =
        flocks.iter().zip(&solutions).map(|(flock, solution)| stored(flock, solution)).collect();
    let hashes: Vec<(u64, String)> =
        solutions.iter().zip(&maps).map(|(solution, map)| (solution.hash(), map_hash(map))).collect();
    let (Some(solution), Some(map), Some(flock), Some(hash)) =
        (solutions.first(), maps.first(), flocks.first(), hashes.first())
    else {
        return Err(CommandError::user("a flock needs a robot"));
    };
    let tracks: Vec<Vec<TrajectoryPoint>> = members.iter().map(|member| track(member, solution)).collect();
    let records: Vec<_> = flock.collection().records().collect();
    let joined = Joined {
        robots: members.iter().map(|member| member.name.clone()).collect(),
        members: solution.members().iter().map(|robot| robot.name().to_owned()).collect(),
        all_agree: !met.differ && hashes.iter().all(|other| other == hash),
        solution_hash: format!("{:016x}", hash.0),
        map_hash: hash.1.clone(),
        records_hash: flock.collection().hash()[..16].iter().map(|byte| format!("{byte:02x}")).collect(),
        constraints_between: solution.across,
        searches: met.searches,
        records: (records.len() as u64, records.iter().map(|record| record.bytes().len() as u64).sum()),
        bytes_exchanged: met.bytes_exchanged,
        search_s: met.search_s,
        solution_s,
    };
    write(out, &joined, map, &tracks)?;
    for (member, track) in members.iter().zip(&tracks) {
        let own = out.join(&member.name).join("trajectory_flock.tum");
        write_trajectory(&own, track).map_err(CommandError::failed)?;
    }
    Ok(joined)
}

/// A robot that knows its own records only.
///
/// # Errors
/// When its name is not one of a robot, or its records are not.
pub fn alone(member: &Member) -> Result<Flock, CommandError> {
    let key = RobotKey::of_replay(&member.name).map_err(CommandError::user)?;
    let mut flock = Flock::new(key, EPOCH, Limits::default());
    for record in &member.records {
        flock.collection_mut().take(record).map_err(CommandError::failed)?;
    }
    Ok(flock)
}

/// Each robot sends its records to every other until no robot receives a new one; gives the bytes that were sent.
fn exchange(flocks: &mut [Flock]) -> u64 {
    let mut bytes = 0;
    let mut carry = |message: &Message| {
        let sent = message.encode();
        bytes += sent.len() as u64;
        Message::decode(&sent).expect("what a robot of this build says is read by this build")
    };
    loop {
        let before: Vec<_> = flocks.iter().map(|flock| flock.collection().hash()).collect();
        for to in 0..flocks.len() {
            for from in (0..flocks.len()).filter(|from| *from != to) {
                let have = carry(&flocks[to].have());
                for answer in flocks[from].answer(&have, ANSWER_BYTES) {
                    for further in flocks[to].answer(&carry(&answer), ANSWER_BYTES) {
                        flocks[from].answer(&carry(&further), ANSWER_BYTES);
                    }
                }
            }
        }
        let after = flocks.iter().map(|flock| flock.collection().hash());
        if after.eq(before) {
            return bytes;
        }
    }
}

fn stored(flock: &Flock, solution: &FlockSolution) -> StoredMap {
    stored_or_empty(flock.map(solution).map.as_ref())
}

/// A fused map as it is written; an empty one when there is none.
pub fn stored_or_empty(map: Option<&FusedMap>) -> StoredMap {
    map.map_or_else(StoredMap::empty, stored_map)
}

/// A robot's way in the frame of the flock; nothing when it is not part of it.
pub fn track(member: &Member, solution: &FlockSolution) -> Vec<TrajectoryPoint> {
    let nodes = solution.nodes.iter().find(|((robot, _), _)| robot.name() == member.name);
    let Some((_, nodes)) = nodes else { return Vec::new() };
    let inside: Vec<_> = nodes.iter().filter(|node| node.part == solution.main_part).copied().collect();
    let poses = in_flock_frame(&member.scans, &member.nodes, &inside);
    let point =
        |(scan, pose): (&OwnPose, Pose)| TrajectoryPoint { stamp_ns: scan.stamp_ns, map_from_base: pose };
    member.scans.iter().zip(poses).map(point).collect()
}

/// Writes the outputs: what became of it as JSON, the map, the ways of all robots.
///
/// # Errors
/// When the disk refuses.
pub fn write(
    out: &Path,
    joined: &impl Serialize,
    map: &StoredMap,
    tracks: &[Vec<TrajectoryPoint>],
) -> Result<(), CommandError> {
    let image = occupancy(map);
    let all: Vec<TrajectoryPoint> = tracks.iter().flatten().copied().collect();
    let json = serde_json::to_vec_pretty(joined).map_err(CommandError::failed)?;
    write_trajectory(&out.join("trajectory.tum"), &all).map_err(CommandError::failed)?;
    write_map(out, &image).map_err(CommandError::failed)?;
    write_flock_picture(&out.join("map.png"), &image, tracks).map_err(CommandError::failed)?;
    replace_file(&out.join("flock.json"), &json, Durability::Process).map_err(CommandError::failed)
}
