//! Robots that map synthetic buildings and exchange records.

use super::support::{Building, Noise, drifting};
use flockslam_flock::{Flock, FlockSolution};
use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, ScanId, SubmapClosed};
use flockslam_records::{Limits, Message, RobotKey};
use flockslam_sync_manager::{Settings, SyncManager};
use std::ops::Range;

/// A robot that drives the stretch `range` of a way and publishes what it finds; its odometry begins somewhere of its own.
pub fn robot(name: &str, building: &Building, way: &[Pose], range: Range<usize>, origin: Pose) -> Flock {
    let key = RobotKey::of_replay(name).unwrap();
    let mut flock = Flock::new(key, 1, Limits::default());
    let mut manager = SyncManager::new(Settings::default());
    manager.publish_to_flock();
    let mut noise = Noise(name.bytes().map(u64::from).sum());
    let truth = &way[range];
    for (i, (at, odom)) in truth.iter().zip(drifting(truth, 0.001, 1.002)).enumerate() {
        let id = ScanId { sequence: i as u64, ..ScanId::default() };
        let mut pose = PoseEstimate {
            id,
            odom_from_base: origin * odom,
            submap: i as u32 / 60,
            ..PoseEstimate::default()
        };
        pose.flags = PoseFlags::MATCHED | PoseFlags::INSERT;
        manager.pose(&pose);
        manager.node(building.scan(*at, &mut noise).view().unwrap(), &pose, &[]);
        if i % 60 == 59 {
            manager.submap_closed(&SubmapClosed {
                last: id,
                number: i as u32 / 60,
                ..SubmapClosed::default()
            });
            flock.publish(&manager.take_unpublished()).unwrap();
        }
    }
    manager.finish();
    flock.publish(&manager.take_unpublished()).unwrap();
    flock
}

/// `to` receives the records of `from`, in portions; the messages selected by `lost` are lost.
pub fn exchange(flocks: &mut [Flock], to: usize, from: usize, mut lost: impl FnMut() -> bool) {
    for _ in 0..100 {
        let answers = {
            let have = flocks[to].have();
            flocks[from].answer(&have, 20_000)
        };
        if answers.is_empty() {
            return;
        }
        for answer in answers.iter().filter(|_| !lost()) {
            flocks[to].answer(&Message::decode(&answer.encode()).unwrap(), 0);
        }
    }
}

pub fn meet(flocks: &mut [Flock]) {
    for _ in 0..2 {
        for to in 0..flocks.len() {
            (0..flocks.len())
                .filter(|from| *from != to)
                .for_each(|from| exchange(flocks, to, from, || false));
        }
    }
}

/// Largest error of nodes of other robots as the first robot sees them, metres.
pub fn worst_m(solution: &FlockSolution, ways: &[(&str, &[Pose])]) -> f64 {
    let placed = |name: &str| {
        let nodes = solution.nodes.iter().find(|((robot, _), _)| robot.name() == name).unwrap().1;
        nodes.iter().map(|node| (node.sequence as usize, node.flock_from_base)).collect::<Vec<_>>()
    };
    let (first, start) = placed(ways[0].0)[0];
    let truth_from_flock = ways[0].1[first] * start.inverse();
    let errors = ways.iter().flat_map(|(name, way)| {
        placed(name).into_iter().map(move |(k, at)| (truth_from_flock * at).distance_m(way[k]))
    });
    errors.fold(0.0, f64::max)
}
