//! Simulated pallets that appear, stand and vanish.

use crate::free_space::FreeSpace;
use crate::index::{Segment, Surface, from_to};
use flockslam_geometry::{Point, Pose};
use flockslam_random::Random;
use std::f64::consts::PI;

/// Length and width: half a euro pallet, metres.
const SIZE_M: (f64, f64) = (0.8, 0.6);
/// A pallet is put down so far from the robot, metres …
const PUT_DOWN_M: (f64, f64) = (2.5, 12.0);
/// … and taken away when the robot comes nearer than this, metres.
const IN_THE_WAY_M: f64 = 1.2;
/// It stands, and is away, for so many seconds.
const STAYS_S: (f64, f64) = (10.0, 60.0);

/// A loaded pallet that appears, stands for a while, and vanishes.
#[derive(Clone, Debug)]
pub(super) struct Pallet {
    /// Its middle and its sides, while it is there.
    standing: Option<(Point, [Segment; 4])>,
    changes_at_s: f64,
    random: Random,
}

impl Pallet {
    /// A pallet that is not there yet.
    pub(super) fn new(mut random: Random) -> Self {
        let changes_at_s = random.between(0.0, STAYS_S.1);
        Self { standing: None, changes_at_s, random }
    }

    /// Comes and goes by its own schedule, and goes when the robot comes.
    pub(super) fn decide(&mut self, now_s: f64, room: &FreeSpace, robot: Point) {
        let blocks =
            self.standing.as_ref().is_some_and(|(middle, _)| middle.distance_m(robot) < IN_THE_WAY_M);
        if now_s < self.changes_at_s && !blocks {
            return;
        }
        self.changes_at_s = now_s + self.random.between(STAYS_S.0, STAYS_S.1);
        self.standing = match self.standing {
            Some(_) => None,
            None => self.put_down(room, robot),
        };
    }

    fn put_down(&mut self, room: &FreeSpace, robot: Point) -> Option<(Point, [Segment; 4])> {
        let suits = |place: Point| (PUT_DOWN_M.0..PUT_DOWN_M.1).contains(&place.distance_m(robot));
        let place = room.place_where(&mut self.random, suits);
        let pose = Pose::new(place.x_m, place.y_m, self.random.between(-PI, PI));
        suits(place).then(|| (place, sides(pose)))
    }

    /// Distance to the pallet along a beam, while it is there.
    pub(super) fn cast(&self, from: Point, direction: Point) -> Option<f64> {
        let sides = self.standing.as_ref().map_or(&[][..], |(_, sides)| sides);
        let nearest_m = sides.iter().map(|side| side.cast(from, direction)).fold(f64::INFINITY, f64::min);
        nearest_m.is_finite().then_some(nearest_m)
    }
}

fn sides(pose: Pose) -> [Segment; 4] {
    let (x_m, y_m) = (SIZE_M.0 / 2.0, SIZE_M.1 / 2.0);
    let corners =
        [(-x_m, -y_m), (x_m, -y_m), (x_m, y_m), (-x_m, y_m)].map(|(x, y)| pose.apply(Point::new(x, y)));
    std::array::from_fn(|i| Segment {
        start: corners[i],
        along: from_to(corners[i], corners[(i + 1) % 4]),
        surface: Surface::Wall,
    })
}
