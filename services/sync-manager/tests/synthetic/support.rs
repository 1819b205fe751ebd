//! Synthetic buildings and front ends that err.

use flockslam_geometry::{Point, Pose};
use flockslam_messages::ScanBuffer;
use std::f64::consts::TAU;

/// Walls as line segments.
#[derive(Clone)]
pub struct Building(pub Vec<(Point, Point)>);

impl Building {
    pub fn new() -> Self {
        Self(Vec::new())
    }

    pub fn wall(mut self, from: (f64, f64), to: (f64, f64)) -> Self {
        self.0.push((Point::new(from.0, from.1), Point::new(to.0, to.1)));
        self
    }

    pub fn block(self, low: (f64, f64), high: (f64, f64)) -> Self {
        self.wall(low, (high.0, low.1))
            .wall((high.0, low.1), high)
            .wall(high, (low.0, high.1))
            .wall((low.0, high.1), low)
    }

    /// A ring of corridors, 2 m wide, with pillars at uneven places on its outer wall.
    pub fn ring() -> Self {
        let ring = Self::new().block((-1.0, -1.0), (17.0, 11.0)).block((1.0, 1.0), (15.0, 9.0));
        let pillars = [
            (2.3, -1.0),
            (5.1, -1.0),
            (6.0, -1.0),
            (11.7, -1.0),
            (13.2, 10.6),
            (9.4, 10.6),
            (7.9, 10.6),
            (3.0, 10.6),
            (-1.0, 8.1),
            (-1.0, 6.3),
            (-1.0, 2.2),
            (16.6, 3.3),
            (16.6, 4.4),
            (16.6, 8.7),
        ];
        pillars.into_iter().fold(ring, |ring, (x, y)| ring.block((x, y), (x + 0.4, y + 0.4)))
    }

    /// A straight corridor with the same niche every 3 m on both sides.
    pub fn endless() -> Self {
        let mut building = Self::new().wall((-2.0, -1.0), (-2.0, 1.0)).wall((80.0, -1.0), (80.0, 1.0));
        for k in 0..28 {
            let x = -2.0 + 3.0 * f64::from(k);
            for side in [-1.0, 1.0] {
                building = building
                    .wall((x, side), (x + 2.0, side))
                    .wall((x + 2.0, side), (x + 2.0, 1.4 * side))
                    .wall((x + 2.0, 1.4 * side), (x + 3.0, 1.4 * side))
                    .wall((x + 3.0, 1.4 * side), (x + 3.0, side));
            }
        }
        building
    }

    pub fn range_m(&self, from: Point, angle_rad: f64) -> f64 {
        let (sin, cos) = angle_rad.sin_cos();
        let hit = |&(a, b): &(Point, Point)| {
            let (ex, ey) = (b.x_m - a.x_m, b.y_m - a.y_m);
            let (dx, dy) = (a.x_m - from.x_m, a.y_m - from.y_m);
            let cross = cos * ey - sin * ex;
            let (range, share) = ((dx * ey - dy * ex) / cross, (dx * sin - dy * cos) / cross);
            (range > 0.0 && (0.0..=1.0).contains(&share)).then_some(range)
        };
        self.0.iter().filter_map(hit).fold(f64::INFINITY, f64::min)
    }

    pub fn scan(&self, at: Pose, noise: &mut Noise) -> ScanBuffer {
        let step = TAU / 360.0;
        let ranges: Vec<f32> = (0..240)
            .map(|i| at.heading_rad - 120f64.to_radians() + f64::from(i) * step)
            .map(|angle| self.range_m(at.position(), angle))
            .map(|range| if range < 12.0 { (range + 0.02 * noise.next()) as f32 } else { f32::INFINITY })
            .collect();
        let mut scan = ScanBuffer::from_ranges(&ranges, (-120f64).to_radians(), step);
        scan.header.range_max_m = 12.0;
        scan
    }
}

/// Even noise in -1 … 1 from a seed.
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / f64::from(1u32 << 30) - 1.0
    }
}

/// Poses every 10 cm along a path through these corners, turning on the spot in steps of 0.2 rad.
pub fn path(corners: &[(f64, f64)]) -> Vec<Pose> {
    let mut poses = Vec::new();
    let mut heading = 0.0;
    for pair in corners.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let turn = Pose::new(0.0, 0.0, dy.atan2(dx) - heading).heading_rad;
        let turns = (turn.abs() / 0.2).ceil() as i32;
        poses.extend(
            (0..turns).map(|k| Pose::new(from.0, from.1, heading + turn * f64::from(k) / f64::from(turns))),
        );
        heading += turn;
        let steps = (dx.hypot(dy) / 0.1).round() as i32;
        let share = |k: i32| f64::from(k) / f64::from(steps);
        poses.extend((0..steps).map(|k| Pose::new(from.0 + dx * share(k), from.1 + dy * share(k), heading)));
    }
    poses
}

/// So many rounds through the ring.
pub fn laps(count: usize) -> Vec<Pose> {
    let corners = [(0.0, 0.0), (16.0, 0.0), (16.0, 10.0), (0.0, 10.0)];
    let mut way: Vec<(f64, f64)> = corners.iter().copied().cycle().take(4 * count + 1).collect();
    way.push((3.0, 0.0));
    path(&way)
}

/// A front end whose heading bends by so many radians a metre and whose paths are too long by a share.
pub fn drifting(truth: &[Pose], bend_rad_m: f64, stretch: f64) -> Vec<Pose> {
    let mut poses = vec![truth[0]];
    for pair in truth.windows(2) {
        let motion = pair[0].to(pair[1]);
        let bent = Pose::new(
            motion.x_m * stretch,
            motion.y_m * stretch,
            motion.heading_rad + bend_rad_m * motion.x_m,
        );
        poses.push(poses[poses.len() - 1] * bent);
    }
    poses
}
