//! How the robot enters the map again after the set has only localized in it: what is driven from there on is a trajectory of its own, which
//! begins where localisation had the robot, relative to the nearest node of the map.

use super::SyncManager;
use crate::solution::{FrozenScan, MAP_ANCHOR};
use flockslam_loop_closure::node::Node;
use flockslam_messages::PoseEstimate;
use flockslam_pose_graph::{Edge, Symmetric};
use flockslam_registration::cloud::Placement;
use std::collections::BTreeSet;
use std::ops::Range;

/// Information of a localized pose relative to a node near it: 0.1 m, as far as the map that it localized in and the
/// present solution may be apart, and 0.03 rad.
const LOCALIZED: Symmetric = [100.0, 0.0, 0.0, 100.0, 0.0, 1111.0];

/// A localized scan is placed relative to the node of the map that was nearest this far before or less, metres.
const ANCHOR_EVERY_M: f64 = 0.5;

/// Stretches that the set has localized in, and where the trajectories behind them begin.
#[derive(Debug, Default)]
pub(super) struct Entries {
    /// The set localizes at the last pose.
    localizes: bool,
    /// The last pose that the set localized with was one in the map.
    is_placed: bool,
    /// The next node enters the map.
    is_due: bool,
    /// The first trajectory behind each stretch.
    trajectories: Vec<u32>,
    entries: Vec<Entry>,
    /// Submaps of such stretches.
    left_out: BTreeSet<u32>,
    /// Where the nearest node of the map was looked for last, and its sequence.
    anchor: Option<(Placement, u64)>,
}

/// The first node of a trajectory, seen from one of the map; both by their sequences.
#[derive(Clone, Copy, Debug)]
struct Entry {
    from: u64,
    to: u64,
    motion: Placement,
}

impl Entries {
    /// The set localizes at a pose, which is one in the map when `is_placed`. Where localisation has not found the robot yet, or the front end
    /// does not know it yet, the pose at which the robot enters says nothing: closures then have to attach what is driven.
    pub(super) fn localize(&mut self, is_placed: bool) {
        (self.localizes, self.is_placed) = (true, is_placed);
    }

    /// The number among those of the map of a trajectory of the front end whose pose comes now.
    pub(super) fn number(&mut self, trajectory: u32) -> u32 {
        let before = self.trajectories.len() as u32;
        if std::mem::take(&mut self.localizes) {
            self.is_due = self.is_placed;
            self.trajectories.push(trajectory + before + 1);
        }
        trajectory + self.trajectories.len() as u32
    }

    /// The number that the front end has for a trajectory of the map.
    pub(super) fn number_of_front_end(&self, trajectory: u32) -> u32 {
        trajectory - self.trajectories.iter().filter(|first| **first <= trajectory).count() as u32
    }

    fn of(&self, sequence: u64) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.to == sequence)
    }
}

fn place(nodes: &[Node], sequence: u64) -> Option<usize> {
    nodes.binary_search_by_key(&sequence, |node| node.sequence).ok()
}

impl SyncManager {
    /// A submap holds nothing but what was seen while the set localized.
    pub fn leave_out(&mut self, number: u32) {
        self.entries.left_out.insert(number);
    }

    /// Whether a submap is part of the map.
    pub(super) fn is_of_map(&self, number: u32) -> bool {
        !self.entries.left_out.contains(&number)
    }

    /// The last node has come with this pose: it may be the one that enters the map.
    pub(super) fn enter(&mut self, pose: &PoseEstimate) {
        if !std::mem::take(&mut self.entries.is_due) {
            return;
        }
        self.entries.anchor = None;
        let at = Placement::from(pose.map_from_base());
        let entry = self.nearest(&at).map(|from| Entry {
            from: self.odometry.nodes()[from].sequence,
            to: pose.id.sequence,
            motion: self.poses[from].to(at),
        });
        self.entries.entries.extend(entry);
    }

    /// The solved node of the map that is nearest to a pose in it.
    fn nearest(&self, at: &Placement) -> Option<usize> {
        let connectivity = self.connectivity(self.poses.len());
        let nodes = self.odometry.nodes();
        let of_map = (0..self.poses.len()).filter(|i| connectivity.is_attached(nodes[*i].trajectory));
        of_map.min_by(|a, b| self.poses[*a].distance_m(at).total_cmp(&self.poses[*b].distance_m(at)))
    }

    /// A scan that the set has localized with, relative to a node of the map near it: it stays there when the map is solved anew.
    pub fn localized(&mut self, pose: &PoseEstimate) -> FrozenScan {
        let at = Placement::from(pose.map_from_base());
        let known = self.entries.anchor.filter(|(before, _)| before.distance_m(&at) <= ANCHOR_EVERY_M);
        let sequence = known.map(|(_, sequence)| sequence).or_else(|| {
            let sequence = self.odometry.nodes()[self.nearest(&at)?].sequence;
            self.entries.anchor = Some((at, sequence));
            Some(sequence)
        });
        let node = sequence.and_then(|sequence| place(self.odometry.nodes(), sequence));
        let (anchor, anchor_from_base) = match (sequence, node) {
            (Some(sequence), Some(node)) => (sequence, self.poses[node].to(at).pose()),
            _ => (MAP_ANCHOR, at.pose()),
        };
        FrozenScan { id: pose.id, stamp_ns: pose.times.sensor_ns, anchor, anchor_from_base }
    }

    /// Where node `i` enters the map, if it does.
    pub(super) fn entered(&self, i: usize) -> Option<Placement> {
        let nodes = self.odometry.nodes();
        let entry = self.entries.of(nodes[i].sequence)?;
        let from = place(&nodes[..i], entry.from)?;
        Some(self.poses.get(from)?.compose(entry.motion))
    }

    /// The constraints of entries among the first `known` nodes.
    pub(super) fn entry_edges(&self, known: usize) -> impl Iterator<Item = Edge> {
        let nodes = &self.odometry.nodes()[..known];
        self.entries.entries.iter().filter_map(move |entry| {
            let (from, to) = (place(nodes, entry.from)?, place(nodes, entry.to)?);
            Some(Edge { from, to, motion: entry.motion, information: LOCALIZED })
        })
    }

    /// These nodes leave the graph: what was measured at them is handed to others by the present solution.
    pub(super) fn move_entries(&mut self, leaving: &Range<usize>) {
        let (nodes, poses) = (self.odometry.nodes(), &self.poses);
        let moved = |entry: &Entry| {
            let (from, to) = (place(nodes, entry.from)?, place(nodes, entry.to)?);
            let trajectory = nodes[to].trajectory;
            let new_to = if leaving.contains(&to) { leaving.end } else { to };
            let stays = nodes.get(new_to).is_some_and(|node| node.trajectory == trajectory);
            if !stays || new_to >= poses.len() {
                return None;
            }
            if (new_to, leaving.contains(&from)) == (to, false) {
                return Some(*entry);
            }
            let of_others =
                (0..poses.len()).filter(|i| !leaving.contains(i) && nodes[*i].trajectory < trajectory);
            let away_m = |i: &usize| poses[*i].distance_m(&poses[new_to]);
            let from = of_others.min_by(|a, b| away_m(a).total_cmp(&away_m(b)))?;
            let motion = poses[from].to(poses[new_to]);
            Some(Entry { from: nodes[from].sequence, to: nodes[new_to].sequence, motion })
        };
        self.entries.entries = self.entries.entries.iter().filter_map(moved).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use flockslam_geometry::Pose;
    use flockslam_messages::{PoseFlags, ScanBuffer, SubmapClosed};

    /// Ranges in a room of 6 m × 4 m, from this far ahead of its middle.
    fn scan(x_m: f64) -> ScanBuffer {
        let range = |degrees: i32| {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            ((3.0 - x_m * cos.signum()) / cos.abs()).min(2.0 / sin.abs()) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians())
    }

    /// Where the robot is at a step: it drives ahead and back.
    fn x_m(step: u64) -> f64 {
        0.05 * if step < 60 { step as f64 } else { 120.0 - step as f64 }
    }

    #[test]
    fn a_robot_that_localisation_had_not_placed_enters_the_map_nowhere() {
        for is_placed in [false, true] {
            let mut manager = SyncManager::new(Settings::default());
            for step in 0..60 {
                let mut pose =
                    PoseEstimate { flags: PoseFlags::MATCHED | PoseFlags::INSERT, ..PoseEstimate::default() };
                (pose.id.sequence, pose.odom_from_base) = (step, Pose::new(x_m(step), 0.0, 0.0));
                if step == 30 {
                    manager.submap_closed(&SubmapClosed { last: pose.id, ..SubmapClosed::default() });
                }
                if (30..40).contains(&step) {
                    pose.flags |= PoseFlags::LOCALIZING | if is_placed { 0 } else { PoseFlags::UNPLACED };
                }
                manager.pose(&pose);
                manager.node(scan(x_m(step)).view().unwrap(), &pose, &[]);
            }
            let known = manager.odometry.nodes().len();
            assert_eq!(manager.entry_edges(known).count(), usize::from(is_placed));
        }
    }

    #[test]
    fn after_localizing_the_map_is_made_further_where_localisation_has_the_robot() {
        let mut manager = SyncManager::new(Settings::default());
        // The front end slips while the set localizes.
        let slipped = Pose::new(0.7, -0.3, 0.2);
        for step in 0..110 {
            let at = Pose::new(x_m(step), 0.0, 0.0);
            let mut pose =
                PoseEstimate { flags: PoseFlags::MATCHED | PoseFlags::INSERT, ..PoseEstimate::default() };
            (pose.id.sequence, pose.odom_from_base) = (step, at);
            if step == 40 {
                manager.submap_closed(&SubmapClosed { last: pose.id, ..SubmapClosed::default() });
            }
            match step {
                0..40 => {}
                40..70 => (pose.flags, pose.submap) = (pose.flags | PoseFlags::LOCALIZING, 1),
                _ => {
                    (pose.odom_from_base, pose.map_from_odom) = (slipped * at, slipped.inverse());
                    // The first scans may still carry the number of the submap before.
                    (pose.submap, pose.corrections) = (if step < 72 { 1 } else { 2 }, 9);
                }
            }
            manager.pose(&pose);
            manager.node(scan(x_m(step)).view().unwrap(), &pose, &[]);
        }
        manager.leave_out(1);
        let mut notice = SubmapClosed { number: 2, ..SubmapClosed::default() };
        notice.last.sequence = 109;
        let correction = manager.submap_closed(&notice);
        assert!(correction.map_from_odom.distance_m(slipped.inverse()) < 0.05, "{correction:?}");
        assert_eq!((correction.trajectory, correction.attached), (0, 1));
        assert!(correction.revision > 9, "who localized before has given as many");
        let numbers = |submaps: Vec<flockslam_map_fusion::PlacedSubmap>| -> Vec<u32> {
            submaps.iter().map(|placed| placed.number).collect()
        };
        assert_eq!(numbers(manager.submap_poses()), [0, 2]);
        let solution = manager.finish();
        assert_eq!((solution.trajectory.len(), solution.detached.len()), (80, 0));
        assert_eq!(numbers(solution.submaps), [0, 2]);
        for placed in &solution.trajectory {
            let off_m = placed.map_from_base.distance_m(Pose::new(x_m(placed.id.sequence), 0.0, 0.0));
            assert!(off_m < 0.05, "{}: {off_m} m", placed.id.sequence);
        }
    }
}
