//! When records of others are passed on: a record that its author may still send to a neighbour itself is held back for some seconds.

use super::link::address;
use flockslam_records::{Collection, LogState, Vector};
use std::collections::{BTreeSet, VecDeque};
use std::time::{Duration, Instant};

/// Records that a near robot has published itself are relayed by others only after this: by then other robots have received them from their author.
const RELAY_DELAY: Duration = Duration::from_secs(4);
/// What there was is noted this often.
const STEP: Duration = Duration::from_secs(1);

/// Keeps the state of a short time ago, so that a record is not sent by every robot that has it.
#[derive(Default)]
pub struct Relay {
    /// When it was noted, and where each log ended: the oldest first.
    noted: VecDeque<(Instant, Vector)>,
}

impl Relay {
    /// Takes note of what there is.
    pub fn look(&mut self, now: Instant, collection: &Collection) {
        if self.noted.back().is_none_or(|(at, _)| now - *at >= STEP) {
            self.noted.push_back((now, collection.vector()));
        }
        // The first is the newest that is old enough.
        while self.noted.get(1).is_some_and(|(at, _)| now - *at >= RELAY_DELAY) {
            self.noted.pop_front();
        }
    }

    /// The records of a robot, and those that it will have received from robots that are `near` themselves.
    pub fn held_back<'a>(
        &self,
        mut theirs: Vector,
        collection: &Collection,
        near: impl Iterator<Item = &'a String>,
    ) -> Vector {
        let near: BTreeSet<&str> = near.map(String::as_str).collect();
        let before = self.noted.front().map(|(_, vector)| vector);
        for log in collection.vector().logs {
            if !near.contains(address(&log.robot).as_str()) {
                continue;
            }
            let old = before.and_then(|before| before.log(&log.robot, log.epoch));
            let end = old.map_or(0, |old| old.numbers.end());
            let place = theirs
                .logs
                .binary_search_by(|other| (&other.robot, other.epoch).cmp(&(&log.robot, log.epoch)));
            let place = place.unwrap_or_else(|place| {
                let (robot, epoch) = (log.robot.clone(), log.epoch);
                theirs
                    .logs
                    .insert(place, LogState { robot, epoch, numbers: Default::default(), digest: [0; 16] });
                place
            });
            let published = &mut theirs.logs[place];
            if end < log.numbers.end() && log.numbers.end() != published.numbers.end() {
                (end..log.numbers.end()).for_each(|number| published.numbers.insert(number));
                // What is only supposed is nothing to argue about.
                published.digest = log.digest;
            }
        }
        theirs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_records::{Content, Limits, Record, RobotKey, Withdrawal};

    #[test]
    fn records_that_their_author_publishes_are_relayed_later() {
        let (author, start) = (RobotKey::of_replay("b").unwrap(), Instant::now());
        let mut collection = Collection::new(Limits::default());
        let say = |collection: &mut Collection, number: u64| {
            let content = Content::Withdrawal(Withdrawal { epoch: 9, number });
            collection.insert(Record::new(&author, 1, number, &content).unwrap());
        };
        let mut relay = Relay::default();
        let near = [address(author.id())];
        let missing = |relay: &Relay, collection: &Collection, near: &[String]| {
            let held_back = relay.held_back(Vector::default(), collection, near.iter());
            collection.missing(&held_back, 1 << 20).len()
        };
        say(&mut collection, 0);
        // Nothing was noted yet; a robot that is not near cannot publish it itself.
        assert_eq!((missing(&relay, &collection, &near), missing(&relay, &collection, &[])), (0, 1));
        relay.look(start, &collection);
        say(&mut collection, 1);
        assert_eq!(missing(&relay, &collection, &near), 1);
        for second in 1..6 {
            relay.look(start + Duration::from_secs(second), &collection);
        }
        assert_eq!(missing(&relay, &collection, &near), 2);
    }
}
