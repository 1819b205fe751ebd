//! The two experiments of the published NDT system (Trubin et al. 2020) as simulated scans.

use flockslam_geometry::elementary::{hypot, sin_cos};
use flockslam_geometry::{Point, Pose};
use flockslam_lidar_ingest::carmen::write_scan;
use flockslam_messages::ScanBuffer;
use flockslam_random::Random;
use std::f64::consts::TAU;
use std::path::Path;

/// RPLidar A2: beams of a turn, reach, and standard deviations of ranges, metres, and of the direction of each beam, radians.
const BEAMS: usize = 1000;
const REACH_M: f64 = 12.0;
const RANGE_SIGMA_M: f64 = 0.002;
/// Standard deviation of the direction of each beam, radians.
pub const BEARING_SIGMA_RAD: f64 = 0.0175;

/// A wall between two points, or one of its sides.
type Wall = [f64; 4];
/// Thickness of walls, metres.
const THICKNESS_M: f64 = 0.12;

/// Scans with the poses that they were taken from.
pub struct Experiment {
    /// The scans.
    pub scans: Vec<ScanBuffer>,
    /// The pose that each was taken from.
    pub truth: Vec<Pose>,
    /// Position of the person at each scan.
    pub movers: Vec<Point>,
}

impl Experiment {
    /// Writes the first `count` scans as a log.
    pub fn write_log(&self, count: usize, path: &Path) {
        let mut lines = Vec::new();
        for scan in &self.scans[..count] {
            write_scan(&mut lines, scan.view().unwrap()).unwrap();
        }
        std::fs::write(path, lines).unwrap();
    }
}

/// Moves between consecutive scans by odometry and in truth: turn first (degrees), then go ahead (millimetres).
const MOVES: [[f64; 4]; 12] = [
    [2562.0, 13.75, 2556.1, 12.99],
    [1151.0, -31.51, 1142.4, -30.59],
    [900.0, 33.23, 910.0, 33.61],
    [950.0, 12.03, 950.5, 11.55],
    [1710.0, 71.05, 1718.7, 71.25],
    [1349.0, 5.16, 1342.6, 4.76],
    [3961.0, 4.01, 3966.0, 5.33],
    [4212.0, -1.38, 4219.0, 0.46],
    [2600.0, 5.16, 2595.8, 4.48],
    [5400.0, -3.44, 5390.5, -4.08],
    [4250.0, -4.01, 4258.7, -3.13],
    [4183.0, -73.34, 4180.0, -73.84],
];

/// The first room of the flat, with furniture; a corridor leaves it.
const ROOM: [Wall; 12] = [
    [-2.0, -2.2, 8.4, -2.2],
    [-2.0, -2.2, -2.0, 3.4],
    [-2.0, 3.4, 3.7, 3.4],
    [5.85, 3.4, 8.4, 3.4],
    [8.4, -2.2, 8.4, 3.4],
    [3.2, -2.2, 3.2, -1.2],
    [3.2, -1.2, 2.4, -1.2],
    [2.4, -1.2, 2.4, -2.2],
    [-2.0, 1.9, -1.2, 1.9],
    [-1.2, 1.9, -1.2, 3.4],
    [7.2, -2.2, 7.2, -0.6],
    [7.2, -0.6, 8.4, -0.6],
];
/// Where the corridor begins, and which way it leads.
const CORRIDOR_FROM: Pose = Pose { x_m: 5.03, y_m: 2.62, heading_rad: 1.9 };
/// The corridor with rooms on both sides and one at its end: along it and to its left.
const CORRIDOR: [Wall; 26] = [
    [1.2, 1.0, 5.0, 1.0],
    [4.2, 1.0, 4.2, 4.0],
    [4.2, 4.0, 8.4, 4.0],
    [8.4, 4.0, 8.4, 1.0],
    [6.2, 1.0, 13.0, 1.0],
    [12.0, 1.0, 12.0, 4.5],
    [12.0, 4.5, 16.5, 4.5],
    [16.5, 4.5, 16.5, 1.0],
    [14.2, 1.0, 24.0, 1.0],
    [0.8, -1.0, 9.5, -1.0],
    [8.6, -1.0, 8.6, -4.0],
    [8.6, -4.0, 12.4, -4.0],
    [12.4, -4.0, 12.4, -1.0],
    [10.6, -1.0, 17.0, -1.0],
    [16.0, -1.0, 16.0, -3.6],
    [16.0, -3.6, 19.4, -3.6],
    [19.4, -3.6, 19.4, -1.0],
    [18.2, -1.0, 20.8, -1.0],
    [22.8, -1.0, 25.5, -1.0],
    [24.0, -1.0, 24.0, 1.0],
    [19.4, -3.6, 19.4, -7.0],
    [19.4, -7.0, 25.5, -7.0],
    [25.5, -7.0, 25.5, -1.0],
    [20.4, 1.0, 20.4, 0.7],
    [20.4, 0.7, 19.6, 0.7],
    [19.6, 0.7, 19.6, 1.0],
];
/// The door of a room on the corridor: open at first, closed from the eighth scan on.
const DOOR: Wall = [9.5, -1.0, 10.6, -1.0];
const DOOR_CLOSES: usize = 7;

/// Distance from a point to the first wall or person in a direction.
fn cast(walls: &[Wall], people: &[Point], from: Point, angle_rad: f64) -> f64 {
    let (sin, cos) = sin_cos(angle_rad);
    let to_wall = |[x0, y0, x1, y1]: &Wall| {
        let (ox, oy, sx, sy) = (x0 - from.x_m, y0 - from.y_m, x1 - x0, y1 - y0);
        let turn = cos * sy - sin * sx;
        let (distance, share) = ((ox * sy - oy * sx) / turn, (ox * sin - oy * cos) / turn);
        if distance > 0.0 && (0.0..=1.0).contains(&share) { distance } else { f64::INFINITY }
    };
    let to_person = |person: &Point| {
        let (ox, oy) = (person.x_m - from.x_m, person.y_m - from.y_m);
        let (along, beside) = (ox * cos + oy * sin, ox * sin - oy * cos);
        if along > 0.0 && beside.abs() < 0.2 {
            along - (0.04 - beside * beside).sqrt()
        } else {
            f64::INFINITY
        }
    };
    let nearest = walls.iter().map(to_wall).fold(f64::INFINITY, f64::min);
    people.iter().map(to_person).fold(nearest, f64::min)
}

/// One scan of the lidar at a pose, with the odometry of the robot at it.
fn scan(
    number: u64,
    world: (&[Wall], &[Point]),
    pose: Pose,
    odometry: Pose,
    bearing_sigma_rad: f64,
    noise: &mut Random,
) -> ScanBuffer {
    let step = TAU / BEAMS as f64;
    let ranges: Vec<f32> = (0..BEAMS)
        .map(|beam| {
            let angle_rad =
                pose.heading_rad - TAU / 2.0 + step * beam as f64 + bearing_sigma_rad * noise.normal();
            let range_m = cast(world.0, world.1, pose.position(), angle_rad) + RANGE_SIGMA_M * noise.normal();
            if range_m < REACH_M { range_m as f32 } else { f32::INFINITY }
        })
        .collect();
    let mut scan = ScanBuffer::from_ranges(&ranges, -TAU / 2.0, step);
    (scan.header.id.sequence, scan.header.times.sensor_ns) = (number, (number as i64 + 1) * 10_000_000_000);
    (scan.header.odometry, scan.header.has_odometry) = (odometry, 1);
    scan.header.range_max_m = REACH_M as f32;
    scan
}

fn moved(from: Pose, [millimetres, degrees]: [f64; 2]) -> Pose {
    from * Pose::new(0.0, 0.0, degrees.to_radians()) * Pose::new(millimetres / 1e3, 0.0, 0.0)
}

fn along_corridor([u0, v0, u1, v1]: Wall) -> Wall {
    let (start, end) = (CORRIDOR_FROM.apply(Point::new(u0, v0)), CORRIDOR_FROM.apply(Point::new(u1, v1)));
    [start.x_m, start.y_m, end.x_m, end.y_m]
}

/// The four sides of a wall.
fn thick([x0, y0, x1, y1]: Wall) -> [Wall; 4] {
    let (dx, dy) = (x1 - x0, y1 - y0);
    let half = 0.5 * THICKNESS_M / hypot(dx, dy);
    let (nx, ny) = (-half * dy, half * dx);
    let corners = [(x0 + nx, y0 + ny), (x1 + nx, y1 + ny), (x1 - nx, y1 - ny), (x0 - nx, y0 - ny)];
    std::array::from_fn(|i| {
        let (from, to) = (corners[i], corners[(i + 1) % 4]);
        [from.0, from.1, to.0, to.1]
    })
}

/// Thirteen scans in a flat of rooms on a corridor: a door closes, an operator walks a metre behind the robot.
pub fn flat(bearing_sigma_rad: f64) -> Experiment {
    flat_seeded(bearing_sigma_rad, 13)
}

/// The same with other noise.
pub fn flat_seeded(bearing_sigma_rad: f64, seed: u64) -> Experiment {
    let (mut truth, mut odometry) = (vec![Pose::IDENTITY], vec![Pose::IDENTITY]);
    for [odometry_mm, odometry_deg, true_mm, true_deg] in MOVES {
        truth.push(moved(truth[truth.len() - 1], [true_mm, true_deg]));
        odometry.push(moved(odometry[odometry.len() - 1], [odometry_mm, odometry_deg]));
    }
    let open: Vec<Wall> = ROOM.into_iter().chain(CORRIDOR.map(along_corridor)).flat_map(thick).collect();
    let closed: Vec<Wall> = open.iter().copied().chain(thick(along_corridor(DOOR))).collect();
    let movers: Vec<Point> = truth.iter().map(|pose| pose.apply(Point::new(-0.9, 0.3))).collect();
    let mut noise = Random::seeded(seed);
    let scans = (0..truth.len()).map(|i| {
        let walls = if i >= DOOR_CLOSES { &closed } else { &open };
        scan(i as u64, (walls, &movers[i..=i]), truth[i], odometry[i], bearing_sigma_rad, &mut noise)
    });
    Experiment { scans: scans.collect(), truth, movers }
}

/// A room that somebody crosses while the robot, with exact odometry, takes eight scans far apart, the first of them from far away.
pub fn one_mover() -> Experiment {
    let room = [
        [-3.0, -3.0, 7.0, -3.0],
        [7.0, -3.0, 7.0, 4.0],
        [7.0, 4.0, -3.0, 4.0],
        [-3.0, 4.0, -3.0, -3.0],
        [5.8, -3.0, 5.8, -1.8],
        [5.8, -1.8, 7.0, -1.8],
    ];
    let truth = [
        (-2.0, -1.0, 0.0),
        (-0.6, -1.2, 0.1),
        (0.8, -1.0, 0.2),
        (2.2, -0.7, 0.5),
        (3.4, 0.0, 1.6),
        (3.0, 1.2, 2.9),
        (1.8, 1.2, 3.1),
        (0.6, 0.9, 3.0),
    ];
    let truth = truth.map(|(x, y, heading)| Pose::new(x, y, heading)).to_vec();
    let movers: Vec<Point> =
        (0..8).map(|i| Point::new(4.0 - 0.7 * f64::from(i), 2.5 - 0.1 * f64::from(i))).collect();
    let mut noise = Random::seeded(8);
    let scans = truth.iter().enumerate().map(|(i, pose)| {
        scan(i as u64, (&room, &movers[i..=i]), *pose, *pose, BEARING_SIGMA_RAD, &mut noise)
    });
    Experiment { scans: scans.collect(), truth, movers }
}
