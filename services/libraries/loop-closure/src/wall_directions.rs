//! The directions of walls: most walls of a building stand parallel or square to others (Coughlan and Yuille 1999), or are of a few such
//! groups (Schindler and Dellaert 2004). So a straight wall that is seen now tells how far the heading has drifted since the first ones.

use flockslam_geometry::elementary::{atan2, sin_cos};
use flockslam_registration::cloud::PackedPoint;
use std::f64::consts::FRAC_PI_2;

/// Points of a wall lie within this of a straight line, metres …
const THICKNESS_M: f64 = 0.04;
/// … and each within this of the one before, metres.
const GAP_M: f64 = 0.6;
/// Points of a wall at least.
const POINTS_MIN: f64 = 6.0;
/// Directions within this of each other are those of parallel walls, radians.
const PARALLEL_RAD: f64 = 0.035;
/// Least weight of the walls that give a direction, m²: with points off by 2 cm it is known to 6 mrad.
const WEIGHT_MIN_M2: f64 = 10.0;
/// Least share of the weight of all walls.
const SHARE_MIN: f64 = 0.4;
/// Bins of directions in a quarter turn.
const BINS: usize = 360;
const BIN_RAD: f64 = FRAC_PI_2 / BINS as f64;
/// A direction is known when so many scans have seen walls of it.
const SCANS_MIN: f64 = 20.0;
/// Rounds in which the middle of the walls near a direction is looked for.
const ROUNDS: usize = 4;

/// The angle modulo a quarter turn, from minus to plus an eighth, radians.
pub fn modulo_quarter(angle_rad: f64) -> f64 {
    angle_rad - FRAC_PI_2 * (angle_rad / FRAC_PI_2).round()
}

/// The direction in which most straight walls of a scan stand, modulo a quarter turn, radians, in the frame of its points, which are in
/// the order of their beams; `None` where too little of the scan is straight.
pub fn wall_direction_rad(points: &[PackedPoint]) -> Option<f64> {
    let walls = walls(points);
    let total_m2: f64 = walls.iter().map(|wall| wall.weight_m2).sum();
    let parallel = |direction_rad: f64| {
        let (mut weight_m2, mut off) = (0.0, 0.0);
        for wall in &walls {
            let off_rad = modulo_quarter(wall.direction_rad - direction_rad);
            if off_rad.abs() <= PARALLEL_RAD {
                weight_m2 += wall.weight_m2;
                off += wall.weight_m2 * off_rad;
            }
        }
        (weight_m2, direction_rad + off / weight_m2)
    };
    let groups = walls.iter().map(|wall| parallel(wall.direction_rad));
    let (_, middle_rad) = groups.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let (weight_m2, direction_rad) = parallel(middle_rad);
    let is_clear = weight_m2 >= WEIGHT_MIN_M2 && weight_m2 >= SHARE_MIN * total_m2;
    is_clear.then(|| modulo_quarter(direction_rad))
}

/// A straight wall in a scan.
struct Wall {
    direction_rad: f64,
    /// The sum of squares of how far its points lie from their middle: the direction's variance is that of a point divided by this.
    weight_m2: f64,
}

/// The straight walls in a scan: runs of points on a line.
fn walls(points: &[PackedPoint]) -> Vec<Wall> {
    let mut walls = Vec::new();
    let (mut run, mut last) = (PointRun::default(), None::<PackedPoint>);
    for &point in points {
        let (x_m, y_m) = (point.x_m(), point.y_m());
        let is_near = last.is_some_and(|last| {
            let (dx, dy) = (x_m - last.x_m(), y_m - last.y_m());
            dx * dx + dy * dy <= GAP_M * GAP_M
        });
        if !is_near || !run.continues(x_m, y_m) {
            walls.extend(run.wall());
            run = PointRun::default();
        }
        run.add(x_m, y_m);
        last = Some(point);
    }
    walls.extend(run.wall());
    walls
}

/// Neighbouring points that may lie on a line: their number and sums.
#[derive(Clone, Copy, Default)]
struct PointRun {
    count: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl PointRun {
    fn add(&mut self, x_m: f64, y_m: f64) {
        self.count += 1.0;
        self.x += x_m;
        self.y += y_m;
        self.xx += x_m * x_m;
        self.xy += x_m * y_m;
        self.yy += y_m * y_m;
    }

    /// Direction of the line through the points, radians, and the sums of squares along and across it.
    fn line(&self) -> (f64, f64, f64) {
        let (xx, yy) = (self.xx - self.x * self.x / self.count, self.yy - self.y * self.y / self.count);
        let xy = self.xy - self.x * self.y / self.count;
        let half = 0.5 * ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt();
        let mean = 0.5 * (xx + yy);
        (0.5 * atan2(2.0 * xy, xx - yy), mean + half, mean - half)
    }

    /// Whether one point more lies on the line.
    fn continues(&self, x_m: f64, y_m: f64) -> bool {
        if self.count < 3.0 {
            return true;
        }
        let (direction_rad, _, across) = self.line();
        let (sin, cos) = sin_cos(direction_rad);
        let off_m = (y_m - self.y / self.count) * cos - (x_m - self.x / self.count) * sin;
        off_m.abs() <= THICKNESS_M && self.is_thin(across)
    }

    fn is_thin(&self, across: f64) -> bool {
        across <= self.count * THICKNESS_M * THICKNESS_M / 4.0
    }

    fn wall(&self) -> Option<Wall> {
        if self.count < POINTS_MIN {
            return None;
        }
        let (direction_rad, weight_m2, across) = self.line();
        self.is_thin(across).then_some(Wall { direction_rad, weight_m2 })
    }
}

/// How a direction lies to the walls of nearly that direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParallelWalls {
    /// From the direction to theirs, radians.
    pub off_rad: f64,
    /// How far they agree: 0 where they stand in all directions alike, 1 where they are parallel.
    pub agreement: f64,
}

/// The directions of walls in the map, modulo a quarter turn, as scans have seen them.
#[derive(Clone, Debug)]
pub struct WallDirections {
    /// By bin: scans that saw walls of this direction, and the sum of how far these are from the middle of the bin, radians.
    bins: Vec<(f64, f64)>,
}

impl Default for WallDirections {
    fn default() -> Self {
        Self { bins: vec![(0.0, 0.0); BINS] }
    }
}

impl WallDirections {
    /// Counts a scan that saw walls of this direction.
    pub fn add(&mut self, direction_rad: f64) {
        let number = bin(direction_rad);
        let (count, off) = &mut self.bins[number];
        *count += 1.0;
        *off += modulo_quarter(direction_rad - middle_rad(number));
    }

    /// The walls within 2° of a direction; `None` where too few scans have seen such walls.
    pub fn parallel(&self, direction_rad: f64) -> Option<ParallelWalls> {
        let (mut count, mut off_rad) = self.around(direction_rad, PARALLEL_RAD);
        if count < SCANS_MIN {
            return None;
        }
        // Where most of them are, which their mean is not.
        for _ in 1..ROUNDS {
            let (narrow, more_rad) = self.around(direction_rad + off_rad, 0.5 * PARALLEL_RAD);
            (count, off_rad) = (narrow, off_rad + more_rad);
        }
        let (all, _) = self.around(direction_rad + off_rad, PARALLEL_RAD);
        let agreement = (2.0 * count / all - 1.0).max(0.0);
        let is_known = all >= SCANS_MIN && off_rad.abs() <= PARALLEL_RAD;
        is_known.then_some(ParallelWalls { off_rad, agreement })
    }

    /// Scans that saw walls within `reach_rad` of a direction, and how far these are from it in the mean, radians.
    fn around(&self, direction_rad: f64, reach_rad: f64) -> (f64, f64) {
        let reach = (reach_rad / BIN_RAD).round() as usize;
        let first = bin(direction_rad) + BINS - reach;
        let (mut count, mut off) = (0.0, 0.0);
        for number in (first..=first + 2 * reach).map(|number| number % BINS) {
            let (of_bin, from_middle) = self.bins[number];
            count += of_bin;
            off += of_bin * modulo_quarter(middle_rad(number) - direction_rad) + from_middle;
        }
        (count, if count > 0.0 { off / count } else { 0.0 })
    }
}

fn bin(direction_rad: f64) -> usize {
    ((modulo_quarter(direction_rad) / BIN_RAD + 0.5 * BINS as f64) as usize).min(BINS - 1)
}

fn middle_rad(bin: usize) -> f64 {
    (bin as f64 + 0.5) * BIN_RAD - 0.5 * FRAC_PI_2
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_random::Random;

    /// What a lidar sees of something around it, with its noise.
    fn seen(range_m: impl Fn(f64) -> f64, random: &mut Random) -> Vec<PackedPoint> {
        let beams = (0..360).map(|i| f64::from(i).to_radians());
        let points = beams.filter_map(|angle_rad| {
            let range_m = range_m(angle_rad) + 0.01 * random.normal();
            PackedPoint::from_metres(range_m * angle_rad.cos(), range_m * angle_rad.sin())
        });
        points.collect()
    }

    #[test]
    fn the_walls_of_a_room_tell_the_heading_and_a_round_room_does_not() {
        let mut random = Random::new(1, "wall directions");
        for heading_rad in [-2.0, -0.77, 0.0, 0.3, 0.8, 3.0] {
            let room = |angle_rad: f64| {
                let (sin, cos) = (angle_rad + heading_rad).sin_cos();
                (4.0 / cos.abs()).min(2.5 / sin.abs())
            };
            let direction_rad = wall_direction_rad(&seen(room, &mut random)).unwrap();
            let off_rad = modulo_quarter(direction_rad + heading_rad);
            assert!(off_rad.abs() < 0.004, "{off_rad} rad off at {heading_rad} rad");
        }
        assert_eq!(wall_direction_rad(&seen(|_| 2.0, &mut random)), None);
        assert_eq!(wall_direction_rad(&[]), None);
    }

    #[test]
    fn parallel_walls_agree_and_walls_in_all_directions_do_not() {
        let mut random = Random::new(2, "wall directions");
        let mut parallel = WallDirections::default();
        assert_eq!(parallel.parallel(0.1), None);
        // They stand across the border between one quarter turn and the next.
        let at_rad = 0.5 * FRAC_PI_2;
        (0..200).for_each(|_| parallel.add(at_rad + 0.004 * random.normal()));
        for off_rad in [-0.02, 0.0, 0.02] {
            let walls = parallel.parallel(at_rad - off_rad).unwrap();
            assert!((walls.off_rad - off_rad).abs() < 0.001 && walls.agreement > 0.9, "{walls:?}");
        }
        assert_eq!(parallel.parallel(at_rad + 0.2), None);
        let mut all = WallDirections::default();
        (0..5000).for_each(|_| all.add(random.between(0.0, 3.0)));
        let walls = all.parallel(0.3).unwrap();
        assert!(walls.agreement < 0.2, "{walls:?}");
    }
}
