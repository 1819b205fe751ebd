//! What a flock costs as it grows: records, memory and time of the common solution, for so many robots that drive the same ring of
//! corridors, each connected to the next.
//!
//! `cargo bench -p flockslam-sync-manager --bench flock_scaling -- [ROBOTS]` prints one line; a process for each number, so that memory is that of one.

#![allow(clippy::disallowed_methods, reason = "no result depends on tests")]

#[allow(dead_code, reason = "what several programs share, one of them does not need all of")]
#[path = "../tests/synthetic/support.rs"]
mod support;
#[path = "../tests/synthetic/synthetic_flock.rs"]
#[allow(dead_code, reason = "what several programs share, one of them does not need all of")]
mod synthetic_flock;

use flockslam_flock::Flock;
use flockslam_geometry::Pose;
use flockslam_records::{CONSTRAINTS_MAX, Constraint, Content, Limits, NodeName, Record, RobotId, RobotKey};
use std::sync::Arc;
use std::time::Instant;
use support::{Building, laps};

/// Robots that are really mapped for; the others have the same drives under other names.
const DRIVES: usize = 6;
/// Robots are connected at every so many of their nodes.
const CONNECTED_EVERY: usize = 12;

/// A robot's records, and its nodes: sequence and true pose.
struct Drive {
    contents: Vec<Content>,
    nodes: Vec<(u64, Pose)>,
}

fn main() {
    let robots: usize = std::env::args()
        .skip(1)
        .find(|argument| argument != "--bench")
        .map_or(10, |robots| robots.parse().expect("a number of robots"));
    let drives: Vec<Drive> = (0..DRIVES.min(robots)).map(drive).collect();
    let limits = Limits { robots_max: robots + 1, ..Limits::default() };
    let mut flock = Flock::new(key(0), 1, limits);
    let before_kb = resident_kb();
    for robot in 0..robots {
        let mut contents = drives[robot % drives.len()].contents.clone();
        if robot > 0 {
            contents.extend(ties(robot, &drives));
        }
        for (number, content) in (0..).zip(&contents) {
            let record = Record::new(&key(robot), 1, number, content).expect("a record");
            flock.collection_mut().insert(record);
        }
    }
    let published_kb = resident_kb();
    let started = Instant::now();
    let solution = flock.solution(false);
    let first_s = started.elapsed().as_secs_f64();
    let started = Instant::now();
    let again = flock.solution(false);
    assert_eq!(solution, again, "the same records, the same layout");
    println!(
        "{robots} robots: {} in one map, {} nodes, {:.1} MB of records, {} bytes of what one has, {:.0} MB for records, \
         {:.0} MB at most, first solution {first_s:.2} s, again {:.2} s",
        solution.members().len(),
        solution.nodes.values().map(Vec::len).sum::<usize>(),
        flock.collection().bytes() as f64 * 1e-6,
        flock.have().encode().len(),
        (published_kb - before_kb) as f64 * 1e-3,
        most_resident_kb() as f64 * 1e-3,
        started.elapsed().as_secs_f64()
    );
}

fn key(robot: usize) -> RobotKey {
    RobotKey::of_replay(&format!("r{robot:04}")).expect("a name")
}

/// One lap of the ring.
fn drive(number: usize) -> Drive {
    let way = laps(1);
    let name = format!("d{number}");
    let origin = Pose::new(7.0 * number as f64, 3.0, 0.5 * number as f64);
    let flock = synthetic_flock::robot(&name, &Building::ring(), &way, 0..way.len(), origin);
    let contents: Vec<Content> =
        flock.collection().records().filter_map(|record: &Arc<Record>| own(&record.content)).collect();
    let mut nodes = Vec::new();
    for content in &contents {
        if let Content::Stretch(stretch) = content {
            nodes.extend(stretch.nodes.iter().map(|node| (node.sequence, way[node.sequence as usize])));
        }
    }
    Drive { contents, nodes }
}

/// What another robot can say as well: all but constraints, which name their robot.
fn own(content: &Content) -> Option<Content> {
    (!matches!(content, Content::Constraints(_))).then(|| content.clone())
}

/// Pose of a robot relative to the one before it, as it would have been measured.
fn ties(robot: usize, drives: &[Drive]) -> Vec<Content> {
    let (before, own) = (&drives[(robot - 1) % drives.len()], &drives[robot % drives.len()]);
    let (from_robot, to_robot): (RobotId, RobotId) = (key(robot - 1).id().clone(), key(robot).id().clone());
    let tie = |(to_sequence, to): &(u64, Pose)| {
        let near = |node: &&(u64, Pose)| (node.1.distance_m(*to) * 1e6) as u64;
        let (from_sequence, from) = before.nodes.iter().min_by_key(near).expect("a drive has nodes");
        Constraint {
            from: NodeName { robot: from_robot.clone(), epoch: 1, sequence: *from_sequence },
            to: NodeName { robot: to_robot.clone(), epoch: 1, sequence: *to_sequence },
            motion: from.inverse() * *to,
            information: [600.0, 0.0, 0.0, 600.0, 0.0, 1e4],
            reach_m: 14.0,
            shift_m: 0.0,
        }
    };
    let ties: Vec<Constraint> = own.nodes.iter().step_by(CONNECTED_EVERY).map(tie).collect();
    ties.chunks(CONSTRAINTS_MAX).map(|some| Content::Constraints(some.to_vec())).collect()
}

fn resident_kb() -> u64 {
    status_kb("VmRSS:")
}

fn most_resident_kb() -> u64 {
    status_kb("VmHWM:")
}

fn status_kb(what: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(what));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}
