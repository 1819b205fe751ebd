//! Simulated people who walk from place to place and make way for the robot.

use super::body::{Body, RADIUS_M, squeezed};
use crate::World;
use crate::free_space::FreeSpace;
use flockslam_geometry::Point;
use flockslam_geometry::elementary::{hypot, sin_cos};
use flockslam_random::Random;
use std::collections::VecDeque;

/// People walk at speeds between these, m/s: from strolling to hurrying.
const SPEEDS_M_S: (f64, f64) = (0.4, 1.5);
/// Nobody makes way faster than this, m/s.
const SPEED_MAX_M_S: f64 = 1.8;
/// Nobody walks to a place farther than this from where the robot is when they set out, metres: else nobody would be seen.
const HAUNT_M: f64 = 12.0;
/// Somebody steers towards the point of their way this far ahead, metres.
const LOOK_AHEAD_M: f64 = 0.3;
/// People make way for a robot nearer than this, metres.
const MAKE_WAY_M: f64 = 1.2;
/// How fast they make way, m/s for each metre that it is nearer; a part of it goes sideways.
const MAKE_WAY_PER_S: f64 = 3.0;
/// Where a wall is in the way, somebody steps aside by so many degrees: the first that is free.
const DETOURS_DEG: [f64; 7] = [0.0, 40.0, -40.0, 80.0, -80.0, 120.0, -120.0];
/// Now and then a person who has arrived stays for up to so many seconds.
const STAYS: (f64, f64) = (0.5, 8.0);

/// A person who walks from place to place.
#[derive(Clone, Debug)]
pub(super) struct Walker {
    position: Point,
    speed_m_s: f64,
    /// The way to the destination, which is its last point.
    way: VecDeque<Point>,
    destination: Point,
    stays_s: f64,
    random: Random,
}

impl Walker {
    /// Stands at a random place.
    pub(super) fn new(room: &FreeSpace, robot: Point, mut random: Random) -> Self {
        let suits = |place: Point| (2.0 * MAKE_WAY_M..HAUNT_M).contains(&place.distance_m(robot));
        let position = room.place_where(&mut random, suits);
        let speed_m_s = random.between(SPEEDS_M_S.0, SPEEDS_M_S.1);
        Self { position, speed_m_s, way: VecDeque::new(), destination: position, stays_s: 0.0, random }
    }

    /// Walks on for a turn of the lidar.
    pub(super) fn walk(&mut self, world: &World, room: &FreeSpace, robot: Point, turn_s: f64) -> Body {
        let wanted = self.wanted(room, robot, turn_s);
        let velocity = shortened(make_way(wanted, self.position, robot), SPEED_MAX_M_S);
        let start = self.position;
        let around = DETOURS_DEG.map(|turn_deg| turned(velocity, turn_deg));
        let step_m = turn_s * velocity.norm_m();
        let clear = around.into_iter().find(|towards| is_clear(world, start, *towards, step_m + RADIUS_M));
        // A person without free space around may leave through anything.
        let taken = clear.unwrap_or(velocity);
        let position = Point::new(start.x_m + turn_s * taken.x_m, start.y_m + turn_s * taken.y_m);
        self.position = squeezed(position, robot);
        Body { start, end: self.position, radius_m: RADIUS_M }
    }

    /// The velocity that leads along the way.
    fn wanted(&mut self, room: &FreeSpace, robot: Point, turn_s: f64) -> Point {
        if self.stays_s > 0.0 {
            self.stays_s -= turn_s;
            return Point::default();
        }
        let reach_m = LOOK_AHEAD_M.max(self.speed_m_s * turn_s);
        while self.way.front().is_some_and(|point| point.distance_m(self.position) < reach_m) {
            self.way.pop_front();
        }
        let Some(ahead) = self.way.front() else {
            self.set_out(room, robot);
            return Point::default();
        };
        let scale = self.speed_m_s / ahead.distance_m(self.position);
        Point::new(scale * (ahead.x_m - self.position.x_m), scale * (ahead.y_m - self.position.y_m))
    }

    fn set_out(&mut self, room: &FreeSpace, robot: Point) {
        let to = room.place_where(&mut self.random, |place| place.distance_m(robot) < HAUNT_M);
        self.way = room.way(std::mem::replace(&mut self.destination, to), to).into();
        if self.random.happens(STAYS.0) {
            self.stays_s = self.random.between(0.0, STAYS.1);
        }
    }
}

/// Away from the robot, and to the right of it, so that no person is pushed along in front of it.
fn make_way(wanted: Point, position: Point, robot: Point) -> Point {
    let (dx, dy) = (position.x_m - robot.x_m, position.y_m - robot.y_m);
    let distance_m = hypot(dx, dy).max(1e-3);
    let push = MAKE_WAY_PER_S * (MAKE_WAY_M - distance_m).max(0.0) / distance_m;
    Point::new(wanted.x_m + push * (dx + 0.5 * dy), wanted.y_m + push * (dy - 0.5 * dx))
}

fn shortened(velocity: Point, longest: f64) -> Point {
    let scale = longest / velocity.norm_m().max(longest);
    Point::new(scale * velocity.x_m, scale * velocity.y_m)
}

fn turned(velocity: Point, turn_deg: f64) -> Point {
    let (sin, cos) = sin_cos(turn_deg.to_radians());
    Point::new(cos * velocity.x_m - sin * velocity.y_m, sin * velocity.x_m + cos * velocity.y_m)
}

fn is_clear(world: &World, from: Point, towards: Point, distance_m: f64) -> bool {
    let length = towards.norm_m().max(f64::MIN_POSITIVE);
    let direction = Point::new(towards.x_m / length, towards.y_m / length);
    world.cast(from, direction, distance_m).is_none()
}
