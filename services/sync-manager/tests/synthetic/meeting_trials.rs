//! Trials of meetings: do robots that share a place find each other, and do those that share none stay apart?

use super::support::{Building, Noise, path};
use super::synthetic_flock::{meet, robot, worst_m};
use flockslam_flock::Flock;
use flockslam_geometry::Pose;
use flockslam_records::{Constraint, Content, NodeName};

/// A merge that is off by more than this anywhere is a false one, metres.
const OFF_MAX_M: f64 = 0.5;

/// Two robots, each in a building, on a way.
pub struct Trial {
    /// What kind of trial it is.
    pub kind: &'static str,
    /// Whether both have seen a place that can be distinguished from others.
    pub is_meeting: bool,
    buildings: [Building; 2],
    ways: [Vec<Pose>; 2],
}

/// What became of a trial.
pub struct Outcome {
    /// Whether the robots ended in one map.
    pub merged: bool,
    /// Largest error between them when they were the same building's, metres; infinite in different buildings.
    pub worst_m: f64,
    /// Records of constraints that the robots found (each holds up to 64 of them), and false ones that were added.
    pub closures: (usize, usize),
    /// Branch-and-bound searches.
    pub searches: u64,
}

impl Outcome {
    /// Whether robots were merged that do not lie so to each other.
    pub fn is_false_merge(&self) -> bool {
        self.merged && self.worst_m > OFF_MAX_M
    }
}

/// The trial of this number. Every eight are: four meetings in offices of all kinds, one in a ring, and three of robots that have
/// no place in common, in corridors that repeat themselves among them.
pub fn trial(number: u64) -> Trial {
    let mut random = Random(Noise(0x9e37 ^ (number + 1).wrapping_mul(0x5851_f42d_4c95_7f2d)));
    match number % 8 {
        0 | 1 => {
            let office = Office::new(&mut random, false);
            let (a, b) =
                (office.way(&mut random, 0.0, 0.65, false), office.way(&mut random, 0.35, 1.0, false));
            meeting("office", office, a, b)
        }
        2 => {
            let office = Office::new(&mut random, false);
            let (a, b) = (office.way(&mut random, 0.0, 0.7, false), office.way(&mut random, 0.2, 1.0, true));
            meeting("office, opposite ways", office, a, b)
        }
        3 => {
            let office = Office::new(&mut random, true);
            let (a, b) =
                (office.way(&mut random, 0.0, 0.75, false), office.way(&mut random, 0.15, 1.0, false));
            meeting("office, equal rooms", office, a, b)
        }
        4 => {
            let (building, way) = ring(&mut random);
            let third = way.len() / 3;
            Trial {
                kind: "ring",
                is_meeting: true,
                ways: [way[..2 * third].to_vec(), way[third..].to_vec()],
                buildings: [building.clone(), building],
            }
        }
        5 => different_buildings("different offices", &mut random, false),
        6 => different_buildings("different offices, equal rooms", &mut random, true),
        _ => {
            let (period_m, deep_m) = (random.between(2.4, 4.0), random.between(0.25, 0.6));
            let ways = [path(&[(24.0, 0.0), (48.0, 0.0)]), path(&[(70.0, 0.0), (94.0, 0.0)])];
            let corridor = niches(period_m, deep_m);
            Trial {
                kind: "one corridor of niches",
                is_meeting: false,
                buildings: [corridor.clone(), corridor],
                ways,
            }
        }
    }
}

fn meeting(kind: &'static str, office: Office, a: Vec<Pose>, b: Vec<Pose>) -> Trial {
    let building = office.building;
    Trial { kind, is_meeting: true, buildings: [building.clone(), building], ways: [a, b] }
}

fn different_buildings(kind: &'static str, random: &mut Random, equal: bool) -> Trial {
    // Built alike: corridors equally wide.
    let seed = random.0.0;
    let one = Office::new(random, equal);
    let width_m = one.half_m;
    let mut other = Office::new(&mut Random(Noise(seed ^ 0xabcd_ef01)), equal);
    if !equal {
        other = Office::with_width(&mut Random(Noise(seed ^ 0xabcd_ef01)), equal, width_m);
    }
    let ways = [one.way(random, 0.0, 0.8, false), other.way(random, 0.1, 1.0, false)];
    Trial { kind, is_meeting: false, buildings: [one.building, other.building], ways }
}

/// Runs a trial: both map alone, meet, search for each other, and then false constraints are added: one for each record of constraints that they have
/// found, but twelve at least; a third of the draws are groups of false constraints that agree. The same trial has the same outcome.
pub fn run(trial: &Trial) -> Outcome {
    let [a, b] = &trial.ways;
    let mut flocks = vec![
        robot("a", &trial.buildings[0], a, 0..a.len(), Pose::new(3.0, 4.0, 1.0)),
        robot("b", &trial.buildings[1], b, 0..b.len(), Pose::new(-50.0, 20.0, -2.5)),
    ];
    meet(&mut flocks);
    let mut found = 0;
    for k in 0..flocks.len() {
        found += flocks[k].search(u64::MAX).unwrap().len();
        meet(&mut flocks);
    }
    let false_count = add_false_constraints(&mut flocks[1], found.max(12), a.len() as u64);
    meet(&mut flocks);
    let solution = flocks[0].solution(true);
    let merged = solution.members().len() == 2;
    let in_one_building = trial.is_meeting || trial.kind == "one corridor of niches";
    let worst_m = match (merged, in_one_building) {
        (true, true) => worst_m(&solution, &[("a", a), ("b", b)]),
        (true, false) => f64::INFINITY,
        (false, _) => 0.0,
    };
    Outcome {
        merged,
        worst_m,
        closures: (found, false_count),
        searches: flocks.iter().map(Flock::searches).sum(),
    }
}

/// Robot b publishes false constraints to nodes of a.
fn add_false_constraints(flock: &mut Flock, count: usize, seed: u64) -> usize {
    let solution = flock.solution(false);
    let nodes = |name: &str| -> Vec<(NodeName, Pose)> {
        let ((robot, epoch), nodes) =
            solution.nodes.iter().find(|((robot, _), _)| robot.name() == name).unwrap();
        let named = |sequence| NodeName { robot: robot.clone(), epoch: *epoch, sequence };
        nodes.iter().map(|node| (named(node.sequence), node.flock_from_base)).collect()
    };
    let (of_a, of_b) = (nodes("a"), nodes("b"));
    let mut random = Random(Noise(seed));
    let mut published = 0;
    let mut publish = |from: &NodeName, to: &NodeName, motion: Pose| {
        let information = [600.0, 0.0, 0.0, 600.0, 0.0, 1e4];
        let (from, to) = (from.clone(), to.clone());
        let constraint = Constraint { from, to, motion, information, reach_m: 0.5, shift_m: 0.0 };
        flock.record(&Content::Constraints(vec![constraint])).unwrap();
    };
    while published < count {
        let motion =
            Pose::new(random.between(-8.0, 8.0), random.between(-8.0, 8.0), random.between(-3.1, 3.1));
        let (from, to) = (random.below(of_a.len()), random.below(of_b.len()));
        if random.below(3) > 0 {
            publish(&of_a[from].0, &of_b[to].0, motion);
            published += 1;
            continue;
        }
        // As many agreeing false constraints as stay less than half of what is true: of two groups of equal size neither is known to be right.
        let a_from_b = of_a[from].1 * motion * of_b[to].1.inverse();
        for k in 0..(count / 8).clamp(2, 5) {
            let (from, to) = ((from + 4 * k) % of_a.len(), (to + 4 * k) % of_b.len());
            publish(&of_a[from].0, &of_b[to].0, of_a[from].1.inverse() * a_from_b * of_b[to].1);
            published += 1;
        }
    }
    published
}

/// Draws from a seed.
struct Random(Noise);

impl Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + 0.5 * (self.0.next() + 1.0) * (high - low)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.between(0.0, count as f64) as usize).min(count - 1)
    }
}

/// A corridor along x with rooms on both sides.
struct Office {
    building: Building,
    length_m: f64,
    half_m: f64,
    /// Middle of each door, and its side.
    doors: Vec<(f64, f64)>,
}

impl Office {
    /// An office at random; in one of equal rooms only the furniture differs.
    fn new(random: &mut Random, equal: bool) -> Self {
        let half_m = if equal { 1.0 } else { random.between(0.85, 1.2) };
        Self::with_width(random, equal, half_m)
    }

    fn with_width(random: &mut Random, equal: bool, half_m: f64) -> Self {
        let length_m = random.between(24.0, 32.0);
        let mut office = Self {
            building: Building::new()
                .wall((0.0, -half_m), (0.0, half_m))
                .wall((length_m, -half_m), (length_m, half_m)),
            length_m,
            half_m,
            doors: Vec::new(),
        };
        for side in [-1.0, 1.0] {
            let mut x = 0.0;
            while x < length_m - 1.5 {
                let wide_m = if equal { 3.5 } else { random.between(2.4, 5.0) };
                let end = if length_m - x - wide_m < 2.4 { length_m } else { x + wide_m };
                office.room(random, side, x, end, equal);
                x = end;
            }
        }
        office
    }

    fn room(&mut self, random: &mut Random, side: f64, low: f64, high: f64, equal: bool) {
        let wall = side * self.half_m;
        let deep_m = if equal { 3.5 } else { random.between(2.5, 5.0) };
        let back = wall + side * deep_m;
        let door = if equal { low + 1.2 } else { random.between(low + 0.7, high - 0.7) };
        let mut building = std::mem::replace(&mut self.building, Building::new())
            .wall((low, wall), (door - 0.5, wall))
            .wall((door + 0.5, wall), (high, wall))
            .wall((low, wall), (low, back))
            .wall((high, wall), (high, back))
            .wall((low, back), (high, back));
        for _ in 0..2 + random.below(3) {
            let (x, wide_m) = (random.between(low + 0.1, high - 1.0), random.between(0.3, 0.9));
            let (y, long_m) = (random.between(1.6, deep_m - 0.7), random.between(0.3, 0.6));
            let (near, far) = (wall + side * y, wall + side * (y + long_m));
            building = building.block((x, near.min(far)), (x + wide_m, near.max(far)));
        }
        self.building = building;
        self.doors.push((door, side));
    }

    /// Along the corridor between two shares of its length, into some rooms on the way.
    fn way(&self, random: &mut Random, from: f64, to: f64, back: bool) -> Vec<Pose> {
        let along = |share: f64| 1.0 + share * (self.length_m - 2.0);
        let mut doors: Vec<(f64, f64)> =
            self.doors.iter().copied().filter(|(x, _)| (along(from)..along(to)).contains(x)).collect();
        doors.retain(|_| random.below(3) == 0);
        doors.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut corners = vec![(along(from), 0.0)];
        for (x, side) in doors {
            if x - corners[corners.len() - 1].0 > 0.3 {
                corners.extend([(x, 0.0), (x, side * (self.half_m + 0.9)), (x, 0.0)]);
            }
        }
        corners.push((along(to), 0.0));
        if back {
            corners.reverse();
        }
        path(&corners)
    }
}

/// A ring of corridors with pillars and niches at random, and a way around it.
fn ring(random: &mut Random) -> (Building, Vec<Pose>) {
    let (wide, high) = (random.between(12.0, 16.0), random.between(8.0, 12.0));
    let mut building = Building::new()
        .block((-1.0, -1.0), (wide + 1.0, high + 1.0))
        .block((1.0, 1.0), (wide - 1.0, high - 1.0));
    for k in 0..18 {
        let size = random.between(0.25, 0.6);
        let (x, y) = match k % 4 {
            0 => (random.between(0.0, wide - 1.0), -1.0),
            1 => (random.between(0.0, wide - 1.0), high + 1.0 - size),
            2 => (-1.0, random.between(0.0, high - 1.0)),
            _ => (wide + 1.0 - size, random.between(0.0, high - 1.0)),
        };
        building = building.block((x, y), (x + size, y + size));
    }
    let corners = [(0.0, 0.0), (wide, 0.0), (wide, high), (0.0, high)];
    let around: Vec<(f64, f64)> = corners.into_iter().cycle().take(6).collect();
    (building, path(&around))
}

/// A corridor with the same niche again and again on both sides, longer than anybody sees.
fn niches(period_m: f64, deep_m: f64) -> Building {
    let mut building = Building::new();
    for k in 0..(120.0 / period_m) as u32 {
        let x = period_m * f64::from(k);
        for side in [-1.0, 1.0] {
            let (wall, back) = (side, side * (1.0 + deep_m));
            let (begin, end) = (x + 0.6 * period_m, x + period_m);
            building = building
                .wall((x, wall), (begin, wall))
                .wall((begin, wall), (begin, back))
                .wall((begin, back), (end, back))
                .wall((end, back), (end, wall));
        }
    }
    building
}
