//! Simulated doors: where they hang, and when they open and close.

use crate::World;
use crate::free_space::FreeSpace;
use crate::index::{Segment, Surface, from_to};
use flockslam_geometry::Point;
use flockslam_geometry::elementary::sin_cos;
use flockslam_random::Random;
use std::f64::consts::PI;

/// Doors hang in passages of this width, metres.
const WIDTH_M: (f64, f64) = (0.7, 1.7);
/// On both sides of a door there is at least this much room, metres.
const DEPTH_M: f64 = 1.0;
/// Doors are at least this far apart, metres.
const APART_M: f64 = 3.0;
/// A door stays open or closed for so many seconds.
const STAYS_S: (f64, f64) = (8.0, 40.0);
/// It opens for a body nearer to its middle than this, metres.
const OPENS_AT_M: f64 = 1.5;
/// Directions in which a passage is measured, over half a circle.
const DIRECTIONS: u32 = 18;
/// Ways from the robot to somewhere that are looked at for each door in search of a passage.
const WAYS_PER_DOOR: u32 = 20;

/// A door across a passage that opens and closes.
#[derive(Clone, Debug)]
pub(super) struct Door {
    leaf: Segment,
    middle: Point,
    is_closed: bool,
    changes_at_s: f64,
    random: Random,
}

/// Hangs up to `count` doors into passages on ways through a world.
pub(super) fn hang(count: u32, world: &World, room: &FreeSpace, robot: Point, seed: u64) -> Vec<Door> {
    let (mut doors, mut random) = (Vec::<Door>::new(), Random::new(seed, "doors"));
    for _ in 0..WAYS_PER_DOOR * count {
        if doors.len() == count as usize {
            break;
        }
        let way = room.way(robot, room.place_away_from(robot, 0.0, &mut random));
        let first = random.below(way.len());
        let apart = |place: &&Point| doors.iter().all(|door| door.middle.distance_m(**place) >= APART_M);
        if let Some(leaf) = way[first..].iter().filter(apart).find_map(|place| passage(world, *place)) {
            doors.push(Door::new(leaf, Random::new(seed, &format!("door {}", doors.len()))));
        }
    }
    doors
}

/// The line across the passage that a place is in, from wall to wall, if it is in one.
fn passage(world: &World, place: Point) -> Option<Segment> {
    let across = |step: u32| {
        let (sin, cos) = sin_cos(PI * f64::from(step) / f64::from(DIRECTIONS));
        let reach = |sign: f64| world.cast(place, Point::new(sign * cos, sign * sin), WIDTH_M.1);
        let (right_m, left_m) = (reach(1.0)?, reach(-1.0)?);
        let start = Point::new(place.x_m - left_m * cos, place.y_m - left_m * sin);
        let end = Point::new(place.x_m + right_m * cos, place.y_m + right_m * sin);
        Some((right_m + left_m, start, end, Point::new(-sin, cos)))
    };
    let narrowest = (0..DIRECTIONS).filter_map(across).min_by(|a, b| a.0.total_cmp(&b.0));
    let (width_m, start, end, through) = narrowest?;
    let is_open =
        |sign: f64| world.cast(place, Point::new(sign * through.x_m, sign * through.y_m), DEPTH_M).is_none();
    let fits = (WIDTH_M.0..=WIDTH_M.1).contains(&width_m) && is_open(1.0) && is_open(-1.0);
    fits.then(|| Segment { start, along: from_to(start, end), surface: Surface::Wall })
}

impl Door {
    fn new(leaf: Segment, random: Random) -> Self {
        let middle = Point::new(leaf.start.x_m + leaf.along.x_m / 2.0, leaf.start.y_m + leaf.along.y_m / 2.0);
        Self { leaf, middle, is_closed: false, changes_at_s: 0.0, random }
    }

    /// Opens or closes by its own schedule, and opens for bodies that are near.
    pub(super) fn decide(&mut self, now_s: f64, mut passers: impl Iterator<Item = Point>) {
        if now_s >= self.changes_at_s {
            self.is_closed = !self.is_closed;
            self.changes_at_s = now_s + self.random.between(STAYS_S.0, STAYS_S.1);
        }
        if self.is_closed && passers.any(|passer| passer.distance_m(self.middle) < OPENS_AT_M) {
            self.is_closed = false;
            self.changes_at_s = now_s + self.random.between(STAYS_S.0, STAYS_S.1);
        }
    }

    /// Distance to the door along a beam, when it is closed.
    pub(super) fn cast(&self, from: Point, direction: Point) -> Option<f64> {
        let distance_m = if self.is_closed { self.leaf.cast(from, direction) } else { f64::INFINITY };
        distance_m.is_finite().then_some(distance_m)
    }
}
