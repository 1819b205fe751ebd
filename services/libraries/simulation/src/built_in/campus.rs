//! The campus: 50 000 m² outdoors, made from a seed.

use crate::drawing::Drawing;
use crate::floor_plan::FloorPlan;
use crate::index::Surface;
use crate::outdoors::{Outdoors, Plant};
use crate::terrain::Terrain;
use flockslam_geometry::Point;
use flockslam_geometry::elementary::{atan2, hypot, sin_cos};
use flockslam_random::Random;

const SIZE_M: (f64, f64) = (250.0, 200.0);
/// Crossings of the paths: columns and rows, the first one's place, their spacing, and how far off it they lie, metres.
const CROSSINGS: (usize, usize) = (4, 3);
const FIRST_M: (f64, f64) = (25.0, 25.0);
const SPACING_M: (f64, f64) = (66.0, 75.0);
const OFF_M: f64 = 7.0;
/// Nothing stands nearer to the middle of a path than this, metres.
const PATH_M: f64 = 2.2;
/// Columns and rows of the crossings in the order of the tour: 1.5 km with three loops.
const TOUR: [(usize, usize); 24] = [
    (0, 0),
    (1, 0),
    (1, 1),
    (0, 1),
    (0, 0),
    (1, 0),
    (2, 0),
    (3, 0),
    (3, 1),
    (2, 1),
    (2, 0),
    (2, 1),
    (2, 2),
    (1, 2),
    (0, 2),
    (0, 1),
    (0, 0),
    (1, 0),
    (1, 1),
    (2, 1),
    (3, 1),
    (3, 2),
    (2, 2),
    (1, 2),
];
/// Length of a hedge at the edge of the campus, metres.
const HEDGE_M: f64 = 18.0;
/// What the blocks between the paths are.
const BLOCKS: [Block; 6] =
    [Block::Building, Block::Lawn, Block::CarPark, Block::Grove, Block::Lawn, Block::Lawn];

#[derive(Clone, Copy)]
enum Block {
    Building,
    Lawn,
    CarPark,
    Grove,
}

/// Buildings with glass and colonnades, lawns, a car park, a grove, hedges along some paths, on uneven ground. The layout,
/// the ground and the tour's orientation follow from `seed`.
pub(crate) fn campus(seed: u64) -> FloorPlan {
    Campus::new(seed).finish()
}

struct Campus {
    drawing: Drawing,
    random: Random,
    crossings: Vec<Point>,
    plants: Vec<Plant>,
}

impl Campus {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, "campus");
        let crossings = (0..CROSSINGS.0 * CROSSINGS.1)
            .map(|i| {
                let (column, row) = ((i % CROSSINGS.0) as f64, (i / CROSSINGS.0) as f64);
                let mut off_m = || random.between(-OFF_M, OFF_M);
                let (dx, dy) = (off_m(), off_m());
                Point::new(FIRST_M.0 + column * SPACING_M.0 + dx, FIRST_M.1 + row * SPACING_M.1 + dy)
            })
            .collect();
        Self { drawing: Drawing::new(SIZE_M), random, crossings, plants: Vec::new() }
    }

    fn finish(mut self) -> FloorPlan {
        let mut blocks = BLOCKS;
        for i in (1..blocks.len()).rev() {
            blocks.swap(i, self.random.below(i + 1));
        }
        for (i, block) in blocks.into_iter().enumerate() {
            let (column, row) = (i % (CROSSINGS.0 - 1), i / (CROSSINGS.0 - 1));
            self.block(block, self.middle(column, row));
        }
        self.edges();
        self.along_the_paths();
        let terrain = Terrain::new(SIZE_M, &mut self.random);
        let tour = self.tour();
        let paths = self.paths();
        self.drawing.finish(&tour).outdoors(Outdoors::new(terrain, self.plants, paths))
    }

    /// The tour, mirrored as drawn.
    fn tour(&mut self) -> Vec<[f64; 2]> {
        let (mirror_x, mirror_y) = (self.random.happens(0.5), self.random.happens(0.5));
        let at = |(column, row): (usize, usize)| {
            let column = if mirror_x { CROSSINGS.0 - 1 - column } else { column };
            let row = if mirror_y { CROSSINGS.1 - 1 - row } else { row };
            let Point { x_m, y_m } = self.crossings[row * CROSSINGS.0 + column];
            [x_m, y_m]
        };
        TOUR.map(at).to_vec()
    }

    /// Middle of the block north-east of a crossing.
    fn middle(&self, column: usize, row: usize) -> Point {
        let corner = row * CROSSINGS.0 + column;
        let corners = [corner, corner + 1, corner + CROSSINGS.0, corner + CROSSINGS.0 + 1];
        let sum = corners
            .iter()
            .fold((0.0, 0.0), |sum, i| (sum.0 + self.crossings[*i].x_m, sum.1 + self.crossings[*i].y_m));
        Point::new(sum.0 / 4.0, sum.1 / 4.0)
    }

    fn block(&mut self, block: Block, middle: Point) {
        match block {
            Block::Building => self.building(middle),
            Block::Lawn => self.scatter(middle, (24.0, 28.0), (3, 2)),
            Block::CarPark => self.car_park(middle),
            Block::Grove => self.scatter(middle, (24.0, 28.0), (30, 8)),
        }
    }

    /// A building: two sides of masonry with pilasters, one of glass before a back wall, one with a colonnade.
    fn building(&mut self, middle: Point) {
        let (length_m, width_m) = (self.random.between(26.0, 34.0), self.random.between(20.0, 30.0));
        let turn_deg = self.random.between(-6.0, 6.0);
        let (sin, cos) = sin_cos(turn_deg.to_radians());
        let at = |u: f64, v: f64| (middle.x_m + u * cos - v * sin, middle.y_m + u * sin + v * cos);
        let put = |drawing: &mut Drawing, surface, [u, v, length, width]: [f64; 4]| {
            let (x, y) = at(u, v);
            drawing.made_of(surface).rectangle([x, y, length, width, turn_deg]);
        };
        // The core is masonry; the glass stands before its south side, the colonnade before its north side.
        put(&mut self.drawing, Surface::Wall, [0.0, 0.0, length_m, width_m]);
        let front_m = -0.5 * width_m - 3.0;
        put(&mut self.drawing, Surface::Glass, [0.0, front_m, length_m, 0.05]);
        for i in 0..=(length_m / 6.0) as usize {
            let u = -0.5 * length_m + 6.0 * i as f64;
            put(&mut self.drawing, Surface::Wall, [u, front_m, 0.15, 0.15]);
        }
        for i in 0..=(length_m / 4.0) as usize {
            let u = -0.5 * length_m + 4.0 * i as f64;
            put(&mut self.drawing, Surface::Wall, [u, 0.5 * width_m + 3.0, 0.4, 0.4]);
        }
        for i in 0..=(width_m / 5.0) as usize {
            let v = -0.5 * width_m + 5.0 * i as f64;
            for u in [-0.5 * length_m - 0.15, 0.5 * length_m + 0.15] {
                put(&mut self.drawing, Surface::Wall, [u, v, 0.3, 0.4]);
            }
        }
    }

    /// Rows of cars behind kerbs.
    fn car_park(&mut self, middle: Point) {
        for row in [-12.0, 0.0, 12.0] {
            self.drawing.made_of(Surface::Low(0.15)).rectangle([
                middle.x_m,
                middle.y_m + row + 3.0,
                40.0,
                0.3,
                0.0,
            ]);
            for place in 0..15 {
                if !self.random.happens(0.55) {
                    continue;
                }
                let x_m = middle.x_m - 19.6 + 2.8 * f64::from(place) + self.random.between(-0.2, 0.2);
                let y_m = middle.y_m + row + self.random.between(-0.4, 0.4);
                let turn_deg = 90.0 + self.random.between(-3.0, 3.0);
                let length_m = self.random.between(3.8, 4.8);
                self.drawing.made_of(Surface::Low(1.4)).rectangle([x_m, y_m, length_m, 1.8, turn_deg]);
            }
        }
    }

    /// Trees and bushes within a rectangle.
    fn scatter(&mut self, middle: Point, half_m: (f64, f64), (trees, bushes): (usize, usize)) {
        for i in 0..trees + bushes {
            let x_m = middle.x_m + self.random.between(-half_m.0, half_m.0);
            let y_m = middle.y_m + self.random.between(-half_m.1, half_m.1);
            self.tree_or_bush(Point::new(x_m, y_m), i < trees);
        }
    }

    /// A tree or a bush, unless it would stand on a path or off the campus.
    fn tree_or_bush(&mut self, at: Point, is_tree: bool) {
        let radius_m = self.random.between(0.1, 0.25);
        let (length_m, width_m) = (self.random.between(0.8, 3.0), self.random.between(0.8, 1.6));
        let (turn_deg, height_m) = (self.random.between(0.0, 180.0), self.random.between(0.6, 1.5));
        let reach_m = if is_tree { radius_m } else { 0.5 * hypot(length_m, width_m) };
        if !self.is_clear(at, reach_m) {
            return;
        }
        if is_tree {
            self.drawing.made_of(Surface::Wall).round([at.x_m, at.y_m, radius_m]);
        } else {
            self.plants.push(Plant { rectangle: [at.x_m, at.y_m, length_m, width_m, turn_deg], height_m });
        }
    }

    /// What surrounds the campus: trees, long hedges, some walls.
    fn edges(&mut self) {
        let sides = [
            ([0.5 * SIZE_M.0, 6.0], 0.0, SIZE_M.0),
            ([0.5 * SIZE_M.0, SIZE_M.1 - 6.0], 0.0, SIZE_M.0),
            ([6.0, 0.5 * SIZE_M.1], 90.0, SIZE_M.1),
            ([SIZE_M.0 - 6.0, 0.5 * SIZE_M.1], 90.0, SIZE_M.1),
        ];
        for ([x, y], turn_deg, length_m) in sides {
            let pieces = (length_m / 25.0) as usize;
            let (sin, cos) = sin_cos(f64::to_radians(turn_deg));
            for piece in 0..pieces {
                let along_m = (piece as f64 + 0.5) * 25.0 - 0.5 * length_m;
                let middle = Point::new(x + along_m * cos, y + along_m * sin);
                match self.random.share() {
                    share if share < 0.45 => self.hedge(middle, HEDGE_M, turn_deg),
                    share if share < 0.55 => {
                        let turn_deg = turn_deg + self.random.between(-2.0, 2.0);
                        self.drawing
                            .made_of(Surface::Wall)
                            .rectangle([middle.x_m, middle.y_m, 14.0, 6.0, turn_deg]);
                    }
                    share if share < 0.8 => self.scatter(middle, (10.0, 4.0), (3, 2)),
                    _ => {}
                }
            }
        }
    }

    /// Hedges on one side of some paths, now and then a tree, a lamp or a kerb on the other.
    fn along_the_paths(&mut self) {
        for (from, to) in self.paths() {
            let (dx, dy) = (to.x_m - from.x_m, to.y_m - from.y_m);
            let length_m = hypot(dx, dy);
            let turn_deg = atan2(dy, dx).to_degrees();
            let at = |along_m: f64, beside_m: f64| {
                let (u, v) = (dx / length_m, dy / length_m);
                Point::new(from.x_m + along_m * u - beside_m * v, from.y_m + along_m * v + beside_m * u)
            };
            let side = if self.random.happens(0.5) { 1.0 } else { -1.0 };
            if self.random.happens(0.4) {
                let hedge_m = self.random.between(15.0, 40.0);
                let along_m = self.random.between(0.3, 0.7) * length_m;
                self.hedge(at(along_m, side * 3.6), hedge_m, turn_deg);
            }
            if self.random.happens(0.4) {
                let Point { x_m, y_m } = at(0.5 * length_m, -side * 2.6);
                self.drawing.made_of(Surface::Low(0.15)).rectangle([
                    x_m,
                    y_m,
                    length_m - 12.0,
                    0.2,
                    turn_deg,
                ]);
            }
            let trees = self.random.below(3);
            for _ in 0..trees {
                let along_m = self.random.between(6.0, length_m - 6.0);
                let beside_m = -side * self.random.between(3.0, 7.0);
                self.tree_or_bush(at(along_m, beside_m), true);
            }
        }
    }

    fn hedge(&mut self, middle: Point, length_m: f64, turn_deg: f64) {
        let width_m = self.random.between(0.8, 1.4);
        let height_m = self.random.between(0.9, 1.8);
        let (sin, cos) = sin_cos(turn_deg.to_radians());
        let pieces = (length_m / 3.0).ceil() as usize;
        for piece in 0..pieces {
            let along_m = (piece as f64 + 0.5) * 3.0 - 0.5 * length_m;
            let at = Point::new(middle.x_m + along_m * cos, middle.y_m + along_m * sin);
            if self.is_clear(at, 1.8) {
                self.plants.push(Plant { rectangle: [at.x_m, at.y_m, 3.0, width_m, turn_deg], height_m });
            }
        }
    }

    /// Both ends of each path.
    fn paths(&self) -> Vec<(Point, Point)> {
        let at = |column: usize, row: usize| self.crossings[row * CROSSINGS.0 + column];
        let along_x = (0..CROSSINGS.1)
            .flat_map(|row| (1..CROSSINGS.0).map(move |column| ((column - 1, row), (column, row))));
        let along_y = (1..CROSSINGS.1)
            .flat_map(|row| (0..CROSSINGS.0).map(move |column| ((column, row - 1), (column, row))));
        along_x.chain(along_y).map(|(from, to)| (at(from.0, from.1), at(to.0, to.1))).collect()
    }

    /// Whether something that reaches so far around a point leaves all paths free and is on the campus.
    fn is_clear(&self, at: Point, reach_m: f64) -> bool {
        let inside = at.x_m > 1.0 && at.y_m > 1.0 && at.x_m < SIZE_M.0 - 1.0 && at.y_m < SIZE_M.1 - 1.0;
        inside && self.paths().iter().all(|(from, to)| off_m(at, *from, *to) >= PATH_M + reach_m)
    }
}

/// Distance of a point from a straight piece of path, metres.
fn off_m(at: Point, from: Point, to: Point) -> f64 {
    let (dx, dy) = (to.x_m - from.x_m, to.y_m - from.y_m);
    let along = ((at.x_m - from.x_m) * dx + (at.y_m - from.y_m) * dy) / (dx * dx + dy * dy);
    let along = along.clamp(0.0, 1.0);
    at.distance_m(Point::new(from.x_m + along * dx, from.y_m + along * dy))
}
