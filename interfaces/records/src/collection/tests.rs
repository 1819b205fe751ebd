//! Tests of collections: order, exchange between robots, limits, and bytes that are no record.

use super::*;
use crate::{Constraint, Descriptor, NodeName, RecordedNode, RobotKey, Stretch, SubmapRecord, Withdrawal};
use flockslam_geometry::Pose;
use proptest::prelude::*;

fn key(name: &str) -> RobotKey {
    RobotKey::of_replay(name).unwrap()
}

fn withdrawal(number: u64) -> Content {
    Content::Withdrawal(Withdrawal { epoch: 1, number })
}

fn submap(number: u32, size: usize) -> Content {
    Content::Submap(SubmapRecord { number, bytes: vec![number as u8; size] })
}

fn stretch(sequence: u64) -> Content {
    let node = |k: u64| RecordedNode {
        sequence: sequence + 3 * k,
        submap: 2,
        odom_from_base: Pose::new(1.0, -2.0, 3.0),
        motion: Pose::new(0.3, 0.01, -0.02),
        information: [1e4, 10.0, 0.0, 2e4, -5.0, 3e4],
        drift_bound_m: 0.3,
        points: (0..40).map(|i| [100 * i, -7 * i]).collect(),
    };
    let descriptor = Descriptor::of([(1.0, 2.0), (3.0, 3.0)].into_iter());
    Content::Stretch(Stretch {
        trajectory: 1,
        previous: sequence.checked_sub(2),
        descriptor,
        nodes: (0..3).map(node).collect(),
    })
}

fn constraint(from: &RobotKey, to: &RobotKey) -> Content {
    let node = |key: &RobotKey, sequence| NodeName { robot: key.id().clone(), epoch: 1, sequence };
    Content::Constraints(vec![Constraint {
        from: node(from, 7),
        to: node(to, 9),
        motion: Pose::new(-3.25, 0.5, 2.0),
        information: [400.0, 0.0, 0.0, 400.0, 0.0, 1e4],
        reach_m: 14.0,
        shift_m: 0.0,
    }])
}

/// Records of three robots: of everything something, a conflict (two records of one name) among it.
fn records_of_three() -> Vec<Record> {
    let (a, b, c) = (key("a"), key("b"), key("c"));
    let mut records = Vec::new();
    for robot in [&a, &b, &c] {
        let contents =
            [submap(0, 900), stretch(5), constraint(&a, robot), submap(1, 300), withdrawal(0), stretch(30)];
        let distinct =
            |(_, content): &(u64, &Content)| content.kind() != Kind::Constraint || robot.id() != a.id();
        for (number, content) in (0..).zip(&contents).filter(distinct) {
            records.push(Record::new(robot, 1, number, content).unwrap());
        }
    }
    records.push(Record::new(&b, 1, 3, &submap(1, 301)).unwrap());
    // A withdrawal that is itself in doubt withdraws nothing.
    records.push(Record::new(&c, 1, 4, &withdrawal(1)).unwrap());
    records.push(Record::new(&c, 2, 0, &submap(0, 20)).unwrap());
    records
}

fn take_all(collection: &mut Collection, records: &[Record]) {
    for record in records {
        let _ = collection.insert(record.clone());
    }
}

fn names(collection: &Collection) -> Vec<RecordName> {
    collection.records().map(|record| record.name.clone()).collect()
}

proptest! {
    #[test]
    fn order_and_repetition_do_not_matter(order in proptest::collection::vec(0usize..20, 0..60), seed in any::<u64>()) {
        let records = records_of_three();
        let mut all: Vec<usize> = (0..records.len()).collect();
        all.rotate_left((seed % records.len() as u64) as usize);
        if seed & 1 == 1 {
            all.reverse();
        }
        let (mut forward, mut shuffled) = (Collection::default(), Collection::default());
        take_all(&mut forward, &records);
        for at in order.iter().map(|at| at % records.len()).chain(all) {
            shuffled.take(records[at].bytes()).unwrap();
        }
        prop_assert_eq!(names(&forward), names(&shuffled));
        prop_assert_eq!(forward.vector(), shuffled.vector());
        prop_assert_eq!(forward.hash(), shuffled.hash());
        let mut known: Vec<_> = names(&forward);
        known.retain(|name| name.robot.name() == "b" && name.number == 3 || name.robot.name() == "a" && name.number == 0);
        prop_assert!(known.is_empty(), "in doubt or withdrawn: {known:?}");
        prop_assert!(names(&forward).iter().any(|name| name.robot.name() == "c" && name.number == 0));
    }

    /// Three robots, each with a part of the records, exchange in any order over links that lose and repeat: in the end all have the
    /// same records.
    #[test]
    fn robots_that_exchange_records_converge(
        share in proptest::collection::vec(0usize..3, 20),
        talks in proptest::collection::vec((0usize..3, 0usize..3, 200usize..4000, any::<bool>()), 0..30),
    ) {
        let records = records_of_three();
        prop_assert_eq!(records.len(), share.len());
        let mut robots = vec![Collection::default(); 3];
        for (record, owner) in records.iter().zip(&share) {
            robots[*owner].insert(record.clone());
        }
        let rounds = (0..60).map(|k| (k % 3, (k + 1 + k / 3 % 2) % 3, 1500, false));
        for (to, from, budget, lost) in talks.into_iter().chain(rounds) {
            if to != from {
                exchange(&mut robots, to, from, budget, lost);
            }
        }
        prop_assert_eq!(robots[0].hash(), robots[1].hash());
        prop_assert_eq!(robots[1].hash(), robots[2].hash());
        prop_assert_eq!(names(&robots[0]), names(&robots[2]));
        let mut all = Collection::default();
        take_all(&mut all, &records);
        prop_assert_eq!(all.hash(), robots[0].hash());
    }

    #[test]
    fn whatever_bytes_come_nothing_breaks(bytes in proptest::collection::vec(any::<u8>(), 0..300), at in 0usize..4000, flip in 1u8..) {
        let mut collection = Collection::default();
        let _ = collection.take(&bytes);
        let _ = Message::decode(&bytes);
        for record in records_of_three() {
            let mut bytes = record.bytes().to_vec();
            let at = at % bytes.len();
            bytes[at] ^= flip;
            let outcome = collection.take(&bytes);
            let refused = matches!(outcome, Err(_) | Ok(Outcome::Refused(_)));
            prop_assert!(refused, "byte {at} of {:?}", record.name);
            prop_assert!(collection.take(&record.bytes()[..at]).is_err());
            let message = Message::Records(vec![record.bytes().clone()]).encode();
            prop_assert!(Message::decode(&message[..at.min(message.len() - 1)]).is_err());
        }
        prop_assert_eq!(collection.records().count(), 0);
    }
}

/// `to` sends its vector and inserts the records that `from` answers, as far as they arrive; then the reverse.
fn exchange(robots: &mut [Collection], to: usize, from: usize, budget: usize, lost: bool) {
    let have = Message::decode(&Message::Have(robots[to].vector()).encode()).unwrap();
    let answers = robots[from].answer(&have, budget);
    for (k, answer) in answers.iter().enumerate() {
        if lost && k % 2 == 0 {
            continue;
        }
        let answer = Message::decode(&answer.encode()).unwrap();
        for further in robots[to].answer(&answer, budget) {
            robots[from].answer(&further, budget);
        }
    }
}

#[test]
fn records_round_trip() {
    for record in records_of_three() {
        let read = Record::read(record.bytes()).unwrap();
        assert_eq!(read, record);
        let again =
            Record::new(&key(record.name.robot.name()), record.name.epoch, record.name.number, &read.content);
        assert_eq!(again.unwrap().hash, record.hash, "what was read is what is stored");
    }
}

#[test]
fn the_urgent_goes_first_and_within_the_budget() {
    let mut collection = Collection::default();
    take_all(&mut collection, &records_of_three());
    let all = collection.missing(&Vector::default(), usize::MAX);
    let read: Vec<Record> = all.iter().map(|bytes| Record::read(bytes).unwrap()).collect();
    let order: Vec<(Kind, u64)> = read.iter().map(|record| (record.kind(), record.name.number)).collect();
    // Both records of a conflict go with the withdrawals, whatever they say.
    let (conflict, withdrawals) = ([(Kind::Submap, 3); 2], [(Kind::Withdrawal, 4); 4]);
    let stretches = [[(Kind::Stretch, 1); 3], [(Kind::Stretch, 5); 3]].concat();
    let submaps = [vec![(Kind::Submap, 0); 4], vec![(Kind::Submap, 3); 2]].concat();
    let constraints = [(Kind::Constraint, 2); 2];
    let expected: Vec<(Kind, u64)> =
        [&conflict[..], &withdrawals[..], &constraints[..], &stretches[..], &submaps[..]].concat();
    assert_eq!(order, expected);
    let some = collection.missing(&Vector::default(), 1000);
    assert!(some.iter().map(|bytes| bytes.len()).sum::<usize>() <= 1000 && some[..] == all[..some.len()]);
    assert!(!some.is_empty() && some.len() < all.len());
    assert_eq!(collection.missing(&Vector::default(), 1).len(), 1);
    assert!(collection.missing(&collection.vector(), usize::MAX).is_empty());
}

#[test]
fn what_is_too_much_is_refused_and_counted() {
    let limits =
        Limits { robots_max: 2, epochs_max: 1, records_max: 4, robot_bytes_max: 2000, ..Limits::default() };
    let mut collection = Collection::new(limits);
    let mut insert = |name: &str, epoch, number, size| {
        let record = Record::new(&key(name), epoch, number, &submap(number as u32, size)).unwrap();
        collection.insert(record)
    };
    assert_eq!(insert("a", 1, 0, 10), Outcome::New);
    assert_eq!(insert("a", 2, 0, 10), Outcome::Refused(Refusal::Epochs));
    assert_eq!(insert("a", 1, 4, 10), Outcome::Refused(Refusal::Records));
    assert_eq!(insert("a", 1, 3, 1900), Outcome::Refused(Refusal::Bytes));
    assert_eq!(insert("b", 1, 0, 10), Outcome::New);
    assert_eq!(insert("c", 1, 0, 10), Outcome::Refused(Refusal::Robots));
    collection.ban(*key("a").id().public_key());
    assert_eq!(collection.robots().map(RobotId::name).collect::<Vec<_>>(), ["b"]);
    let record = Record::new(&key("a"), 1, 0, &submap(0, 10)).unwrap();
    assert_eq!(collection.take(record.bytes()), Ok(Outcome::Refused(Refusal::NotTrusted)));
    collection.allow_only([]);
    assert_eq!(collection.robots().count(), 0);
    let refused: Vec<(Refusal, u64)> = collection.tally().refused.iter().map(|(why, n)| (*why, *n)).collect();
    assert_eq!(refused, Refusal::ALL[..5].iter().map(|why| (*why, 1_u64)).collect::<Vec<_>>());
    // All robots together.
    let mut collection = Collection::new(Limits { bytes_max: 600, ..Limits::default() });
    let record = |name: &str, size| Record::new(&key(name), 1, 0, &submap(0, size)).unwrap();
    assert_eq!(collection.insert(record("a", 100)), Outcome::New);
    assert_eq!(collection.insert(record("b", 400)), Outcome::Refused(Refusal::AllBytes));
    assert_eq!(collection.tally().refused.get(&Refusal::AllBytes), Some(&1));
    collection.never_refuse(key("b").id().clone());
    assert_eq!(collection.insert(record("b", 400)), Outcome::New);
}

#[test]
fn too_large_lengths_are_rejected_before_allocation() {
    let record = records_of_three().remove(1);
    let mut bytes = record.bytes().to_vec();
    let length_at = 6 + 1 + 1 + 32 + 16;
    bytes[length_at..length_at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(Record::read(&bytes), Err(RecordError::TooMuch { .. })));
    bytes[4] = 9;
    assert_eq!(Record::read(&bytes), Err(RecordError::Version(9)));
    let huge = Content::Submap(SubmapRecord { number: 0, bytes: vec![0; 300_000] });
    assert!(Record::new(&key("a"), 1, 0, &huge).is_err());
}
