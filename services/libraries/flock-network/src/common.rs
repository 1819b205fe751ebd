//! What follows from all records that a robot has: the members of the common map, where their submaps lie, and hashes to compare with
//! other robots.

use flockslam_flock::Flock;
use flockslam_geometry::Pose;
use flockslam_map_fusion::stored_map;
use flockslam_messages::FlockFrame;
use flockslam_records::{Presence, RobotId};
use flockslam_results::StoredMap;
use std::collections::BTreeMap;

/// What a robot concludes of all records that it knows: how the robots lie to each other. A function of the records alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Common {
    /// Hash of the records that it is of.
    pub of_records: [u8; 32],
    /// Names of the robots in the common map, in order.
    pub members: Vec<String>,
    /// Whether this robot is one of at least two.
    pub merged: bool,
    /// Hash of solution and fused map.
    pub map_hash: u64,
    /// Closures between robots: inliers and outliers.
    pub across: (u64, u64),
    /// This robot's log.
    own: Option<Log>,
    /// Submaps of each log in the common map, in order, each with what takes the frame that its evidence is in to that of the flock.
    submaps: BTreeMap<Log, Vec<(u32, Pose)>>,
}

/// A robot, and which of its logs.
type Log = (RobotId, u64);

impl Common {
    /// Works out the solution and the fused map.
    pub fn of(flock: &Flock, epoch: u64) -> Self {
        let solution = flock.solution(false);
        let fused = flock.map(&solution);
        let stored = fused.map.as_ref().map_or_else(StoredMap::empty, stored_map);
        let members = solution.members();
        let own = (flock.robot().clone(), epoch);
        let mut submaps: BTreeMap<Log, Vec<(u32, Pose)>> = BTreeMap::new();
        for (log, placed) in &solution.submaps {
            let in_map = placed.iter().filter(|placed| placed.part == solution.main_part);
            let rows: Vec<_> = in_map.map(|placed| (placed.submap, placed.flock_from_odom)).collect();
            if !rows.is_empty() {
                submaps.insert(log.clone(), rows);
            }
        }
        Self {
            of_records: flock.collection().hash(),
            merged: members.len() > 1 && members.contains(&flock.robot()) && submaps.contains_key(&own),
            members: members.iter().map(|robot| robot.name().to_owned()).collect(),
            map_hash: hash(solution.hash(), &stored),
            across: solution.across,
            own: Some(own),
            submaps,
        }
    }

    /// Pose of the robot's map in that of the flock, given where its own submaps are in its map: the newest submap decides, since
    /// that is where the robot is.
    pub fn frame(&self, map_from_odom: &[(u32, Pose)], revision: u32) -> Option<FlockFrame> {
        let known = |number: u32| {
            let place = map_from_odom.binary_search_by_key(&number, |(number, _)| *number).ok()?;
            Some(map_from_odom[place].1)
        };
        let own = self.own.as_ref().and_then(|own| self.submaps.get(own))?;
        let placed = own.iter().rev().find_map(|(number, pose)| Some((*pose, known(*number)?)));
        let (flock_from_odom, map_from_odom) = placed.filter(|_| self.merged)?;
        Some(FlockFrame {
            flock_from_map: flock_from_odom * map_from_odom.inverse(),
            map_hash: self.map_hash,
            members: self.members.len() as u32,
            revision,
        })
    }

    /// Pose of a robot's map where the robot is: `flock_from_odom` of the submap that it is in, or of the last one before
    /// it that is known. `None` for a robot outside the common map, and for this robot.
    pub fn place_of(&self, presence: &Presence) -> Option<Pose> {
        let log = (presence.robot.clone(), presence.epoch);
        let placed = self.submaps.get(&log).filter(|_| self.own.as_ref() != Some(&log))?;
        let up_to = placed.partition_point(|(number, _)| *number <= presence.submap);
        placed.get(up_to.max(1) - 1).map(|(_, pose)| *pose)
    }

    /// A common map of these logs.
    #[cfg(test)]
    pub fn with_submaps(own: &RobotId, logs: impl IntoIterator<Item = (Log, Vec<(u32, Pose)>)>) -> Self {
        Self { own: Some((own.clone(), 1)), submaps: logs.into_iter().collect(), ..Self::default() }
    }
}

/// FNV-1a over words.
fn hash(solution: u64, map: &StoredMap) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut mix = |word: u64| hash = (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(23);
    [solution, map.width as u64, map.height as u64].into_iter().for_each(&mut mix);
    [map.origin.x_m, map.origin.y_m].into_iter().for_each(|value| mix(value.to_bits()));
    map.for_each_row(|row| {
        for cell in row {
            mix(u64::from(cell.occupied));
            mix(u64::from(cell.free));
        }
    });
    hash
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_submap_that_both_know_decides() {
        let pose = |x: f64| Pose::new(x, 0.0, 0.0);
        let key = flockslam_records::RobotKey::of_replay("a").unwrap();
        let submaps = vec![(0, pose(10.0)), (2, pose(20.0)), (3, pose(30.0))];
        let common = Common {
            merged: true,
            members: vec!["a".to_owned(), "b".to_owned()],
            ..Common::with_submaps(key.id(), [((key.id().clone(), 1), submaps)])
        };
        let frame = common.frame(&[(0, pose(1.0)), (2, pose(2.0))], 7).unwrap();
        assert_eq!((frame.flock_from_map, frame.members, frame.revision), (pose(18.0), 2, 7));
        assert_eq!(common.frame(&[(1, pose(1.0))], 1), None);
        assert_eq!(Common { merged: false, ..common }.frame(&[(0, pose(1.0))], 1), None);
    }
}
