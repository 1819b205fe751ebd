//! Robots that map for themselves and then meet, in synthetic buildings.

use flockslam_geometry::Pose;
use flockslam_messages::{PoseEstimate, PoseFlags, ScanId, SubmapClosed};
use flockslam_records::{Content, Limits, Message, NodeName, RobotKey};
use flockslam_sync_manager::flock::{Flock, FlockLayout};
use flockslam_sync_manager::{Settings, SyncManager};
use std::ops::Range;
use support::{Building, Noise, drifting, laps, path};

mod support;

/// A robot that drives the stretch `range` of a way and tells what it finds; its odometry begins somewhere of its own.
fn robot(name: &str, building: &Building, way: &[Pose], range: Range<usize>, origin: Pose) -> Flock {
    let key = RobotKey::of_replay(name).unwrap();
    let mut flock = Flock::new(key, 1, Settings::default(), Limits::default());
    let mut manager = SyncManager::new(Settings::default());
    manager.tell_the_flock();
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
            flock.say_news(&manager.take_news()).unwrap();
        }
    }
    manager.finish();
    flock.say_news(&manager.take_news()).unwrap();
    flock
}

/// `to` hears what `from` knows, in portions; of the messages those are lost that `lost` says.
fn hear(flocks: &mut [Flock], to: usize, from: usize, mut lost: impl FnMut() -> bool) {
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

fn meet(flocks: &mut [Flock]) {
    for _ in 0..2 {
        for to in 0..flocks.len() {
            (0..flocks.len()).filter(|from| *from != to).for_each(|from| hear(flocks, to, from, || false));
        }
    }
}

/// Largest error of nodes of other robots as the first robot sees them, metres.
fn worst_m(layout: &FlockLayout, ways: &[(&str, &[Pose])]) -> f64 {
    let placed = |name: &str| {
        let nodes = layout.nodes.iter().find(|((robot, _), _)| robot.name() == name).unwrap().1;
        nodes.iter().map(|node| (node.sequence as usize, node.flock_from_base)).collect::<Vec<_>>()
    };
    let (first, start) = placed(ways[0].0)[0];
    let truth_from_flock = ways[0].1[first] * start.inverse();
    let errors = ways.iter().flat_map(|(name, way)| {
        placed(name).into_iter().map(move |(k, at)| (truth_from_flock * at).distance_m(way[k]))
    });
    errors.fold(0.0, f64::max)
}

#[test]
fn robots_with_unknown_starts_find_each_other_and_all_have_the_same_layout() {
    let (building, way) = (Building::ring(), laps(2));
    let third = way.len() / 3;
    let origins = [Pose::new(3.0, 4.0, 1.0), Pose::new(-50.0, 20.0, -2.5), Pose::new(7.0, -90.0, 3.0)];
    let names = ["a", "b", "c"];
    let mut flocks: Vec<Flock> =
        (0..3).map(|k| robot(names[k], &building, &way, k * third..(k + 1) * third, origins[k])).collect();
    assert_eq!(flocks[0].layout(false).members().len(), 1);
    meet(&mut flocks);
    for flock in &mut flocks {
        assert!(!flock.search(u64::MAX).unwrap().is_empty());
        assert!(flock.search(u64::MAX).unwrap().is_empty(), "what was compared is not compared again");
    }
    meet(&mut flocks);
    let layouts: Vec<FlockLayout> = flocks.iter().map(|flock| flock.layout(true)).collect();
    assert!(layouts.iter().all(|layout| *layout == layouts[0] && layout.hash() == layouts[0].hash()));
    assert_eq!(layouts[0].members().len(), 3);
    let ways: Vec<(&str, &[Pose])> = (0..3).map(|k| (names[k], &way[k * third..(k + 1) * third])).collect();
    let worst = worst_m(&layouts[0], &ways);
    assert!(worst < 0.06, "{worst}");

    // A robot that hears everything late, in small portions and over others, works out the same.
    let mut late =
        vec![Flock::new(RobotKey::of_replay("d").unwrap(), 1, Settings::default(), Limits::default())];
    late.push(flocks.swap_remove(1));
    let mut noise = Noise(3);
    hear(&mut late, 0, 1, || noise.next() > 0.2);
    hear(&mut late, 0, 1, || false);
    assert_eq!(late[0].layout(true), layouts[0]);

    // A robot that is not believed any more takes its ties with it.
    let liar = *RobotKey::of_replay("b").unwrap().id().public_key();
    late[0].collection_mut().ban(liar);
    assert!(!late[0].layout(false).members().iter().any(|robot| robot.name() == "b"));
}

#[test]
fn buildings_that_only_look_alike_are_not_merged() {
    // A corridor of equal niches fits everywhere; a ring is another building.
    let corridor = path(&[(0.0, 0.0), (30.0, 0.0)]);
    let origin = Pose::new(1.0, 2.0, 0.5);
    let mut flocks = vec![
        robot("a", &Building::ring(), &laps(1), 0..400, Pose::IDENTITY),
        robot("b", &Building::endless(), &corridor, 0..corridor.len(), origin),
        robot("c", &Building::endless(), &path(&[(36.0, 0.0), (66.0, 0.0)]), 0..250, Pose::IDENTITY),
    ];
    meet(&mut flocks);
    flocks.iter_mut().for_each(|flock| drop(flock.search(u64::MAX).unwrap()));
    meet(&mut flocks);
    let layout = flocks[0].layout(true);
    assert_eq!(layout.members().len(), 1, "{:?}", layout.across);
}

#[test]
fn lies_about_how_robots_lie_to_each_other_do_not_act() {
    let (building, way) = (Building::ring(), laps(2));
    let half = way.len() / 2;
    let mut flocks = vec![
        robot("a", &building, &way, 0..half, Pose::IDENTITY),
        robot("b", &building, &way, half..way.len(), Pose::new(9.0, 9.0, 2.0)),
    ];
    meet(&mut flocks);
    let found: usize = flocks.iter_mut().map(|flock| flock.search(u64::MAX).unwrap().len()).sum();
    meet(&mut flocks);
    let honest = flocks[0].layout(true);
    let nodes = |name: &str| -> Vec<NodeName> {
        let ((robot, epoch), nodes) =
            honest.nodes.iter().find(|((robot, _), _)| robot.name() == name).unwrap();
        let named = |n: &flockslam_sync_manager::flock::PlacedNode| NodeName {
            robot: robot.clone(),
            epoch: *epoch,
            sequence: n.sequence,
        };
        nodes.iter().map(named).collect()
    };
    let (of_a, of_b) = (nodes("a"), nodes("b"));
    let mut noise = Noise(11);
    for k in 0..found {
        let pick = |nodes: &[NodeName], share: f64| {
            nodes[(0.5 * (share + 1.0) * (nodes.len() - 1) as f64) as usize].clone()
        };
        let lie = flockslam_records::Constraint {
            from: pick(&of_a, noise.next()),
            to: pick(&of_b, noise.next()),
            motion: Pose::new(8.0 * noise.next(), 8.0 * noise.next(), 3.0 * noise.next()),
            information: [600.0, 0.0, 0.0, 600.0, 0.0, 1e4],
            reach_m: 0.5,
            shift_m: 0.0,
        };
        assert!(lie.information[0] > 0.0, "{k}");
        flocks[1].say(&Content::Constraint(lie)).unwrap();
    }
    meet(&mut flocks);
    let layout = flocks[0].layout(true);
    let ways = [("a", &way[..half]), ("b", &way[half..])];
    // As many lies as true constraints may keep robots apart, but they must never bend a map.
    if layout.members().len() == 2 {
        let worst = worst_m(&layout, &ways);
        assert!(worst < 0.06, "{worst}, {:?} of {found} true ones", layout.across);
    } else {
        assert_eq!(layout.across.0, 0, "no lie acts");
    }
}
