//! The state that browsers are shown. Each part has a version or a count, so that an outbox can tell what is new.

use crate::health::{Event, Health};
use crate::layer::Layer;
use crate::path::Path;
use crate::stage_latency::LatencySample;
use flockslam_geometry::Pose;
use serde::Serialize;
use std::collections::VecDeque;

/// Latencies of the last ten minutes, one a second.
const LATENCIES_MAX: usize = 600;
/// Events that are kept.
const EVENTS_MAX: usize = 200;

/// Something with a count of how often it has changed.
#[derive(Debug, Default)]
pub struct Versioned<T> {
    value: T,
    version: u64,
}

impl<T: PartialEq> Versioned<T> {
    /// Sets it; the same again is no change.
    pub fn set(&mut self, value: T) {
        if self.value != value {
            self.value = value;
            self.version += 1;
        }
    }
}

impl<T> Versioned<T> {
    /// What it is.
    pub fn get(&self) -> &T {
        &self.value
    }

    /// How often it has changed.
    pub fn version(&self) -> u64 {
        self.version
    }
}

/// The newest of a growing list, each with a number that stays.
#[derive(Debug)]
pub struct Recent<T> {
    items: VecDeque<T>,
    /// Items there have ever been.
    count: u64,
    most: usize,
}

impl<T> Recent<T> {
    fn new(most: usize) -> Self {
        Self { items: VecDeque::with_capacity(most), count: 0, most }
    }

    /// Appends an item; the oldest goes when there are too many.
    pub fn push(&mut self, item: T) {
        if self.items.len() == self.most {
            self.items.pop_front();
        }
        self.items.push_back(item);
        self.count += 1;
    }

    /// Those behind the first `seen` there have been, as far as they are still known.
    pub fn since(&self, seen: u64) -> impl Iterator<Item = &T> {
        let first = self.count - self.items.len() as u64;
        self.items.iter().skip(seen.saturating_sub(first) as usize)
    }

    /// Items there have ever been.
    pub fn count(&self) -> u64 {
        self.count
    }
}

/// Where the robot is now.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RobotNow {
    /// The scan.
    pub sequence: u64,
    /// Pose in the map: metres, metres, radians.
    pub map_from_base: [f64; 3],
    /// The current correction.
    pub map_from_odom: [f64; 3],
    /// `tracking`, `degraded` or `lost`.
    pub quality: &'static str,
    /// Standard deviation of the position along its weakest direction, metres.
    pub sigma_m: f64,
    /// Standard deviation of the heading, radians.
    pub sigma_rad: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Turning, rad/s.
    pub turn_rad_s: f64,
    /// Matching score, 0 … 1; 0 when the scan was not matched.
    pub score: f64,
    /// Way driven, metres.
    pub length_m: f64,
    /// Submap that a scan enters now.
    pub submap: u32,
}

/// Where the parts of the map lie.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Graph {
    /// Number of each placed submap, and its `map_from_odom`.
    pub submaps: Vec<(u32, [f64; 3])>,
    /// Reference poses in odom of submaps, by number.
    pub origins: Vec<(u32, [f64; 3])>,
    /// Closed loops: both ends in the map, metres, and 1 when the loop acts.
    pub closures: Vec<[f64; 5]>,
    /// Searches for loops so far.
    pub searches: u64,
    /// Loops found so far.
    pub accepted: u64,
}

/// Something that moves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Track {
    /// Keeps its number as long as it is seen.
    pub id: u64,
    /// Where it is in odom, metres.
    pub at: [f64; 2],
    /// Its velocity in odom, m/s.
    pub velocity: [f64; 2],
    /// Radius of a circle around it, metres.
    pub radius_m: f64,
}

/// Another robot of the flock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherRobot {
    /// Its name.
    pub name: String,
    /// Where it says that it is, in this robot's map: metres, metres, radians.
    pub map_from_base: [f64; 3],
    /// Seconds since it was received.
    pub age_s: f64,
}

/// Ends of the beams of the current scan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanNow {
    /// In `base_link`, in units of [`SCAN_UNIT_M`].
    pub points: Vec<[i16; 2]>,
    /// Where the robot was: `map_from_base`.
    pub map_from_base: [f64; 3],
}

/// Unit of a scan's coordinates, metres.
pub const SCAN_UNIT_M: f64 = 0.005;

/// What does not change while a set runs.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Head {
    /// Name of the set.
    pub robot: String,
    /// Version of the program.
    pub version: String,
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Whether the map can be saved from the page.
    pub can_save: bool,
}

/// Everything that there is to see, as it is now.
#[derive(Debug)]
pub struct View {
    /// What does not change.
    pub head: Head,
    /// Counts how often what follows was begun anew.
    pub restarts: u64,
    /// Closed submaps, in the map's lattice.
    pub map: Layer,
    /// The grid that is being built, in odom's lattice.
    pub live: Layer,
    /// The way driven.
    pub path: Path,
    /// Where the robot is.
    pub robot: Versioned<Option<RobotNow>>,
    /// The current scan.
    pub scan: Versioned<ScanNow>,
    /// Where submaps lie.
    pub graph: Versioned<Graph>,
    /// Moving objects; `None` without a source.
    pub tracks: Versioned<Option<Vec<Track>>>,
    /// The other robots of the flock.
    pub other_robots: Versioned<Vec<OtherRobot>>,
    /// Whether what is behind is still being read.
    pub is_catching_up: Versioned<bool>,
    /// How the set is; `None` while its supervisor does not answer.
    pub health: Versioned<Option<Health>>,
    /// Latencies.
    pub latencies: Recent<LatencySample>,
    /// What happened.
    pub events: Recent<Event>,
}

impl View {
    /// Nothing seen yet.
    pub fn new(head: Head) -> Self {
        Self {
            head,
            restarts: 0,
            map: Layer::default(),
            live: Layer::default(),
            path: Path::default(),
            robot: Versioned::default(),
            scan: Versioned::default(),
            graph: Versioned::default(),
            tracks: Versioned::default(),
            other_robots: Versioned::default(),
            is_catching_up: Versioned::default(),
            health: Versioned::default(),
            latencies: Recent::new(LATENCIES_MAX),
            events: Recent::new(EVENTS_MAX),
        }
    }

    /// Drops what came from the bus: it is about to be read anew.
    pub fn begin_anew(&mut self) {
        self.restarts += 1;
        (self.map, self.live, self.path) = (Layer::default(), Layer::default(), Path::default());
        (self.robot, self.scan) = (Versioned::default(), Versioned::default());
        (self.graph, self.tracks) = (Versioned::default(), Versioned::default());
        self.other_robots = Versioned::default();
        self.is_catching_up = Versioned::default();
    }
}

/// A pose as it is sent.
pub fn numbers(pose: Pose) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.heading_rad]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_recent_keeps_its_numbers() {
        let mut recent = Recent::new(3);
        (0..5).for_each(|item| recent.push(item));
        let since = |seen| recent.since(seen).copied().collect::<Vec<_>>();
        assert_eq!((since(0), since(3), since(5), recent.count()), (vec![2, 3, 4], vec![3, 4], vec![], 5));
    }
}
