//! People and cars that go to and fro along the paths of a campus.

use super::body::{Body, RADIUS_M};
use flockslam_geometry::Point;
use flockslam_random::Random;

/// People and cars.
const COUNTS: (usize, usize) = (14, 5);
/// Their speeds, m/s.
const WALKING_M_S: (f64, f64) = (0.6, 1.5);
const DRIVING_M_S: (f64, f64) = (2.0, 6.0);
/// How far beside the middle of a path they keep, metres.
const BESIDE_M: (f64, f64) = (1.0, 4.5);
/// They wait while the robot is nearer than this, metres.
const WAITS_M: (f64, f64) = (0.8, 4.0);
/// A car is as three discs in a row, this far apart, of this radius, metres.
const CAR_M: (f64, f64) = (1.3, 0.9);

/// Somebody, or a car, that goes to and fro along a path.
#[derive(Clone, Debug)]
pub(super) struct Passer {
    from: Point,
    /// Unit vector along the path.
    along: Point,
    length_m: f64,
    at_m: f64,
    /// Negative on the way back.
    speed_m_s: f64,
    is_car: bool,
}

/// The traffic on some paths, given by their ends.
pub(super) fn on_paths(paths: &[(Point, Point)], seed: u64) -> Vec<Passer> {
    let mut random = Random::new(seed, "traffic");
    let passer = |i: usize| {
        let (from, to) = paths[random.below(paths.len())];
        Passer::new(from, to, i >= COUNTS.0, &mut random)
    };
    if paths.is_empty() { Vec::new() } else { (0..COUNTS.0 + COUNTS.1).map(passer).collect() }
}

impl Passer {
    fn new(from: Point, to: Point, is_car: bool, random: &mut Random) -> Self {
        let length_m = from.distance_m(to);
        let along = Point::new((to.x_m - from.x_m) / length_m, (to.y_m - from.y_m) / length_m);
        let beside_m = if is_car { BESIDE_M.1 } else { BESIDE_M.0 };
        let (beside_m, speeds) =
            (beside_m + random.between(0.0, 0.6), if is_car { DRIVING_M_S } else { WALKING_M_S });
        let beside_m = if random.happens(0.5) { beside_m } else { -beside_m };
        Self {
            from: Point::new(from.x_m - beside_m * along.y_m, from.y_m + beside_m * along.x_m),
            along,
            length_m,
            at_m: random.between(0.0, length_m),
            speed_m_s: random.between(speeds.0, speeds.1),
            is_car,
        }
    }

    /// Goes on for a turn of the lidar, unless the robot is in the way. The discs that it is made of.
    pub(super) fn pass(&mut self, robot: Point, turn_s: f64) -> impl Iterator<Item = Body> + use<> {
        let start = self.position();
        let waits_m = if self.is_car { WAITS_M.1 } else { WAITS_M.0 };
        if start.distance_m(robot) > waits_m + self.speed_m_s.abs() * turn_s {
            self.at_m += self.speed_m_s * turn_s;
        }
        if !(0.0..=self.length_m).contains(&self.at_m) {
            (self.at_m, self.speed_m_s) = (self.at_m.clamp(0.0, self.length_m), -self.speed_m_s);
        }
        let (end, along, is_car) = (self.position(), self.along, self.is_car);
        let discs = if is_car { -1..=1 } else { 0..=0 };
        discs.map(move |disc| {
            let shift_m = f64::from(disc) * CAR_M.0;
            let shifted = |at: Point| Point::new(at.x_m + shift_m * along.x_m, at.y_m + shift_m * along.y_m);
            let radius_m = if is_car { CAR_M.1 } else { RADIUS_M };
            Body { start: shifted(start), end: shifted(end), radius_m }
        })
    }

    fn position(&self) -> Point {
        Point::new(self.from.x_m + self.at_m * self.along.x_m, self.from.y_m + self.at_m * self.along.y_m)
    }
}
