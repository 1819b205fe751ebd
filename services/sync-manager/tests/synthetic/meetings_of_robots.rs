//! Robots that map for themselves and then meet, in synthetic buildings.

use super::support::{Building, Noise, laps, path};
use super::synthetic_flock::{exchange, meet, robot, worst_m};
use flockslam_flock::{Flock, FlockSolution};
use flockslam_geometry::Pose;
use flockslam_records::{Constraint, Content, Limits, NodeName, RobotKey};

#[test]
fn robots_with_unknown_starts_find_each_other_and_all_have_the_same_layout() {
    let (building, way) = (Building::ring(), laps(2));
    let third = way.len() / 3;
    let origins = [Pose::new(3.0, 4.0, 1.0), Pose::new(-50.0, 20.0, -2.5), Pose::new(7.0, -90.0, 3.0)];
    let names = ["a", "b", "c"];
    let mut flocks: Vec<Flock> =
        (0..3).map(|k| robot(names[k], &building, &way, k * third..(k + 1) * third, origins[k])).collect();
    assert_eq!(flocks[0].solution(false).members().len(), 1);
    meet(&mut flocks);
    for flock in &mut flocks {
        assert!(!flock.search(u64::MAX).unwrap().is_empty());
        assert!(flock.search(u64::MAX).unwrap().is_empty(), "what was compared is not compared again");
    }
    meet(&mut flocks);
    let solutions: Vec<FlockSolution> = flocks.iter().map(|flock| flock.solution(true)).collect();
    assert!(
        solutions.iter().all(|solution| *solution == solutions[0] && solution.hash() == solutions[0].hash())
    );
    assert_eq!(solutions[0].members().len(), 3);
    let ways: Vec<(&str, &[Pose])> = (0..3).map(|k| (names[k], &way[k * third..(k + 1) * third])).collect();
    let worst = worst_m(&solutions[0], &ways);
    assert!(worst < 0.06, "{worst}");

    // A robot that receives everything late, in small portions and over others, works out the same.
    let mut late = vec![Flock::new(RobotKey::of_replay("d").unwrap(), 1, Limits::default())];
    late.push(flocks.swap_remove(1));
    let mut noise = Noise(3);
    exchange(&mut late, 0, 1, || noise.next() > 0.2);
    exchange(&mut late, 0, 1, || false);
    assert_eq!(late[0].solution(true), solutions[0]);

    // A robot that is banned takes its closures with it.
    let banned = *RobotKey::of_replay("b").unwrap().id().public_key();
    late[0].collection_mut().ban(banned);
    assert!(!late[0].solution(false).members().iter().any(|robot| robot.name() == "b"));
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
    let solution = flocks[0].solution(true);
    assert_eq!(solution.members().len(), 1, "{:?}", solution.across);
    assert_eq!(solution.across.0, 0, "no closure between any two of them acts: {:?}", solution.across);
}

#[test]
fn false_constraints_between_robots_do_not_act() {
    let (building, way) = (Building::ring(), laps(2));
    let half = way.len() / 2;
    let mut flocks = vec![
        robot("a", &building, &way, 0..half, Pose::IDENTITY),
        robot("b", &building, &way, half..way.len(), Pose::new(9.0, 9.0, 2.0)),
    ];
    meet(&mut flocks);
    // Records: each may hold several constraints.
    let found: usize = flocks.iter_mut().map(|flock| flock.search(u64::MAX).unwrap().len()).sum();
    assert!(found > 0);
    meet(&mut flocks);
    let honest = flocks[0].solution(true);
    let nodes = |name: &str| -> Vec<NodeName> {
        let ((robot, epoch), nodes) =
            honest.nodes.iter().find(|((robot, _), _)| robot.name() == name).unwrap();
        let named = |n: &flockslam_flock::PlacedNode| NodeName {
            robot: robot.clone(),
            epoch: *epoch,
            sequence: n.sequence,
        };
        nodes.iter().map(named).collect()
    };
    let (of_a, of_b) = (nodes("a"), nodes("b"));
    let mut noise = Noise(11);
    for _ in 0..found {
        let pick = |nodes: &[NodeName], share: f64| {
            nodes[(0.5 * (share + 1.0) * (nodes.len() - 1) as f64) as usize].clone()
        };
        let false_constraint = Constraint {
            from: pick(&of_a, noise.next()),
            to: pick(&of_b, noise.next()),
            motion: Pose::new(8.0 * noise.next(), 8.0 * noise.next(), 3.0 * noise.next()),
            information: [600.0, 0.0, 0.0, 600.0, 0.0, 1e4],
            reach_m: 0.5,
            shift_m: 0.0,
        };
        flocks[1].record(&Content::Constraints(vec![false_constraint])).unwrap();
    }
    meet(&mut flocks);
    let solution = flocks[0].solution(true);
    let ways = [("a", &way[..half]), ("b", &way[half..])];
    // A false constraint for each record of true constraints neither keeps the robots apart nor bends the map.
    assert_eq!(solution.members().len(), 2, "{:?} of {found} true records", solution.across);
    assert!(solution.across.1 >= found as u64, "{:?} of {found} true records", solution.across);
    let worst = worst_m(&solution, &ways);
    assert!(worst < 0.06, "{worst}, {:?} of {found} true records", solution.across);
}

#[test]
fn where_robots_are_tied_few_matches_act_that_are_expected_there() {
    let (building, way) = (Building::ring(), laps(2));
    let half = way.len() / 2;
    let (of_a, of_b) = (&way[..half], &way[half..]);
    let solution = |moves: &[(usize, usize, Pose)]| {
        let mut flocks = vec![
            robot("a", &building, &way, 0..half, Pose::IDENTITY),
            robot("b", &building, &way, half..way.len(), Pose::new(9.0, 9.0, 2.0)),
        ];
        meet(&mut flocks);
        for (at_a, at_b, moved) in moves {
            let from = node_near(&flocks[1], "a", of_a, of_a[*at_a]);
            let to = node_near(&flocks[1], "b", of_b, of_b[*at_b]);
            let motion = of_a[from.sequence as usize].inverse() * of_b[to.sequence as usize] * *moved;
            let information = [600.0, 0.0, 0.0, 600.0, 0.0, 1e4];
            let constraint = Constraint { from, to, motion, information, reach_m: 0.5, shift_m: 0.0 };
            flocks[1].record(&Content::Constraints(vec![constraint])).unwrap();
        }
        meet(&mut flocks);
        flocks[0].solution(false)
    };
    let group: Vec<_> = (0..6).map(|k| (40 + 25 * k, 40 + 25 * k, Pose::IDENTITY)).collect();
    let few = |moved: Pose| [300, 306, 312].map(|at| (at, at, moved));
    let with = |more: &[(usize, usize, Pose)]| solution(&[&group, more].concat()).across;
    assert_eq!(with(&[]), (6, 0));
    assert_eq!(with(&few(Pose::IDENTITY)), (9, 0), "over a metre, far from the others");
    assert_eq!(with(&few(Pose::new(0.6, -0.5, 0.2))), (6, 3), "what does not fit does not act");
    let alone = solution(&few(Pose::IDENTITY));
    assert_eq!((alone.across, alone.members().len()), ((0, 3), 1), "so few tie nobody");
}

/// The node of a robot that was nearest to a pose.
fn node_near(flock: &Flock, name: &str, way: &[Pose], pose: Pose) -> NodeName {
    let solution = flock.solution(false);
    let ((robot, epoch), nodes) = solution.nodes.iter().find(|((robot, _), _)| robot.name() == name).unwrap();
    let at = |sequence: u64| way[sequence as usize];
    let nearest = nodes
        .iter()
        .min_by(|a, b| at(a.sequence).distance_m(pose).total_cmp(&at(b.sequence).distance_m(pose)));
    let sequence = nearest.unwrap().sequence;
    NodeName { robot: robot.clone(), epoch: *epoch, sequence }
}
