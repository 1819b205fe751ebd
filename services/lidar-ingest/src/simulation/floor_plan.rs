use super::planner::PlanningGrid;
use flockslam_geometry::Point;
use std::f64::consts::TAU;

/// Thickness of walls, metres.
const WALL_M: f64 = 0.2;
/// Size of the building, metres.
const SIZE_M: (f64, f64) = (30.0, 20.0);
/// Cells of the planner, metres.
const PLANNING_CELL_M: f64 = 0.1;

/// Centre lines of the walls, x and y of both ends, metres; gaps between them are doors of 1.2 m.
const WALLS: [[f64; 4]; 31] = [
    [0.0, 0.0, 30.0, 0.0],
    [30.0, 0.0, 30.0, 20.0],
    [0.0, 20.0, 30.0, 20.0],
    [0.0, 0.0, 0.0, 20.0],
    // Four rooms in the south, the middle two with a door between them.
    [0.0, 6.0, 2.9, 6.0],
    [4.1, 6.0, 10.4, 6.0],
    [11.6, 6.0, 18.4, 6.0],
    [19.6, 6.0, 25.9, 6.0],
    [27.1, 6.0, 30.0, 6.0],
    [7.5, 0.0, 7.5, 6.0],
    [15.0, 0.0, 15.0, 1.4],
    [15.0, 2.6, 15.0, 6.0],
    [22.5, 0.0, 22.5, 6.0],
    // Three rooms in the north, the eastern two with a door between them.
    [0.0, 14.0, 4.4, 14.0],
    [5.6, 14.0, 14.4, 14.0],
    [15.6, 14.0, 24.4, 14.0],
    [25.6, 14.0, 30.0, 14.0],
    [10.0, 14.0, 10.0, 20.0],
    [20.0, 14.0, 20.0, 17.4],
    [20.0, 18.6, 20.0, 20.0],
    // The block in the middle: two rooms, a way through.
    [8.0, 8.0, 17.4, 8.0],
    [18.6, 8.0, 22.0, 8.0],
    [8.0, 12.0, 10.9, 12.0],
    [12.1, 12.0, 22.0, 12.0],
    [8.0, 8.0, 8.0, 12.0],
    [22.0, 8.0, 22.0, 12.0],
    [15.0, 8.0, 15.0, 9.4],
    [15.0, 10.6, 15.0, 12.0],
    // Wall stubs in the corridors.
    [13.0, 7.6, 13.0, 8.0],
    [16.0, 12.0, 16.0, 12.4],
    [20.5, 6.0, 20.5, 6.4],
];

/// Furniture: centre x and y, length, width in metres, turn in degrees.
const BOXES: [[f64; 5]; 21] = [
    [1.8, 1.4, 1.6, 0.8, 0.0],
    [0.35, 4.2, 0.5, 2.4, 0.0],
    [6.7, 5.0, 1.2, 0.5, 0.0],
    [9.8, 2.4, 1.6, 0.8, 12.0],
    [13.0, 4.2, 1.6, 0.8, -8.0],
    [18.0, 0.6, 3.0, 0.6, 0.0],
    [24.8, 2.2, 1.4, 1.4, 30.0],
    [29.6, 5.0, 0.5, 1.4, 0.0],
    [26.2, 10.2, 2.0, 1.8, 20.0],
    [29.5, 8.5, 0.5, 3.0, 0.0],
    [23.2, 9.0, 0.6, 1.2, 0.0],
    [5.0, 16.0, 5.5, 0.4, 0.0],
    [5.0, 18.2, 5.5, 0.4, 0.0],
    [15.2, 17.2, 3.6, 1.2, 5.0],
    [11.0, 19.5, 1.4, 0.6, 0.0],
    [22.4, 15.8, 0.8, 2.0, 0.0],
    [27.0, 19.0, 2.0, 0.8, 0.0],
    [28.3, 16.2, 1.2, 0.7, 40.0],
    [9.0, 8.9, 0.9, 0.6, 0.0],
    [21.3, 10.0, 0.8, 2.2, 0.0],
    [0.5, 13.0, 0.6, 1.4, 0.0],
];

/// Pillars and round tables: centre and radius, metres.
const ROUNDS: [[f64; 3]; 13] = [
    [2.5, 8.8, 0.25],
    [5.6, 8.8, 0.25],
    [2.5, 11.4, 0.25],
    [5.6, 11.4, 0.25],
    [28.2, 2.6, 0.6],
    [20.8, 3.4, 0.3],
    [13.6, 10.9, 0.2],
    [13.6, 16.2, 0.22],
    [14.8, 18.2, 0.22],
    [16.2, 16.4, 0.22],
    [16.6, 18.4, 0.22],
    [24.6, 16.8, 0.45],
    [28.4, 12.6, 0.3],
];

/// The tour: it enters every room, goes around the block both ways and comes back.
const TOUR: [[f64; 2]; 34] = [
    [4.0, 7.2],
    [3.5, 3.4],
    [3.5, 7.0],
    [11.0, 7.0],
    [11.2, 4.0],
    [14.0, 2.0],
    [17.5, 2.6],
    [19.0, 5.0],
    [19.0, 7.0],
    [18.0, 9.4],
    [14.0, 10.0],
    [11.5, 10.4],
    [11.5, 13.0],
    [15.0, 13.0],
    [15.0, 15.0],
    [18.6, 17.8],
    [21.6, 18.0],
    [25.0, 15.0],
    [25.0, 13.0],
    [28.6, 11.0],
    [24.2, 7.4],
    [26.5, 4.4],
    [26.5, 7.0],
    [19.0, 7.2],
    [9.0, 7.0],
    [4.0, 10.0],
    [5.0, 15.0],
    [1.2, 17.2],
    [8.8, 17.2],
    [5.0, 14.9],
    [5.0, 13.0],
    [15.0, 13.2],
    [23.4, 12.6],
    [23.6, 7.2],
];

/// A building made of line segments.
#[derive(Clone, Debug)]
pub struct FloorPlan {
    outlines: Vec<Outline>,
    way_points: Vec<Point>,
}

/// A closed outline and a circle around it, by which most beams can tell that they miss.
#[derive(Clone, Debug)]
struct Outline {
    segments: Vec<Segment>,
    centre: Point,
    radius_m: f64,
}

#[derive(Clone, Copy, Debug)]
struct Segment {
    start: Point,
    along: Point,
}

impl FloorPlan {
    pub(super) fn built_in() -> Self {
        let corners = WALLS
            .map(wall_corners)
            .into_iter()
            .chain(BOXES.map(box_corners))
            .chain(ROUNDS.map(round_corners));
        let outlines = corners.map(|corners| Outline::new(&corners)).collect();
        Self { outlines, way_points: TOUR.map(|[x, y]| Point::new(x, y)).to_vec() }
    }

    /// Distance to what a beam in `direction` hits first.
    pub(super) fn cast(&self, from: Point, direction: Point, max_m: f64) -> Option<f64> {
        let mut nearest_m = f64::INFINITY;
        for outline in &self.outlines {
            if outline.may_be_hit(from, direction, nearest_m.min(max_m)) {
                nearest_m =
                    outline.segments.iter().map(|s| s.cast(from, direction)).fold(nearest_m, f64::min);
            }
        }
        (nearest_m <= max_m).then_some(nearest_m)
    }

    pub(super) fn way_points(&self) -> &[Point] {
        &self.way_points
    }

    pub(super) fn planning_grid(&self) -> PlanningGrid {
        let cells = |metres: f64| (metres / PLANNING_CELL_M).ceil() as usize + 1;
        let (width, height) = (cells(SIZE_M.0), cells(SIZE_M.1));
        let mut solid = vec![false; width * height];
        for segment in self.segments() {
            let steps = (segment.along.norm_m() / (0.3 * PLANNING_CELL_M)).ceil() as usize;
            for step in 0..=steps {
                let share = step as f64 / steps as f64;
                let x = (segment.start.x_m + share * segment.along.x_m) / PLANNING_CELL_M;
                let y = (segment.start.y_m + share * segment.along.y_m) / PLANNING_CELL_M;
                if x >= 0.0 && y >= 0.0 && (x as usize) < width && (y as usize) < height {
                    solid[y as usize * width + x as usize] = true;
                }
            }
        }
        PlanningGrid::new(width, height, PLANNING_CELL_M, solid)
    }

    fn segments(&self) -> impl Iterator<Item = &Segment> {
        self.outlines.iter().flat_map(|outline| &outline.segments)
    }

    /// Distance from a point to the nearest wall or piece of furniture, metres.
    #[cfg(test)]
    pub(super) fn distance_m(&self, point: Point) -> f64 {
        let to_segment = |segment: &Segment| {
            let offset = Point::new(point.x_m - segment.start.x_m, point.y_m - segment.start.y_m);
            let dot = offset.x_m * segment.along.x_m + offset.y_m * segment.along.y_m;
            let share = (dot / segment.along.norm_m().powi(2)).clamp(0.0, 1.0);
            offset.distance_m(Point::new(share * segment.along.x_m, share * segment.along.y_m))
        };
        self.segments().map(to_segment).fold(f64::INFINITY, f64::min)
    }
}

impl Outline {
    fn new(corners: &[Point]) -> Self {
        let count = corners.len() as f64;
        let sum = corners.iter().fold((0.0, 0.0), |sum, corner| (sum.0 + corner.x_m, sum.1 + corner.y_m));
        let centre = Point::new(sum.0 / count, sum.1 / count);
        let radius_m = corners.iter().map(|corner| corner.distance_m(centre)).fold(0.0, f64::max) + 1e-6;
        let ends = corners.iter().cycle().skip(1);
        let segments = corners
            .iter()
            .zip(ends)
            .map(|(start, end)| Segment { start: *start, along: from_to(*start, *end) });
        Self { segments: segments.collect(), centre, radius_m }
    }

    /// Whether the beam meets the circle around the outline within `max_m`.
    fn may_be_hit(&self, from: Point, direction: Point, max_m: f64) -> bool {
        let offset = from_to(from, self.centre);
        let ahead_m = offset.x_m * direction.x_m + offset.y_m * direction.y_m;
        let in_reach = (-self.radius_m..=max_m + self.radius_m).contains(&ahead_m);
        in_reach && cross(offset, direction).abs() <= self.radius_m
    }
}

impl Segment {
    /// A beam p + t·d meets a segment q + u·s where, with × the cross product, t = (q - p)×s / d×s and
    /// u = (q - p)×d / d×s. Returns t, or infinity when they do not meet.
    fn cast(&self, from: Point, direction: Point) -> f64 {
        let offset = from_to(from, self.start);
        let inverse = 1.0 / cross(direction, self.along);
        let t = cross(offset, self.along) * inverse;
        let u = cross(offset, direction) * inverse;
        // A parallel beam gives an infinite or undefined u, and no hit.
        if (0.0..=1.0).contains(&u) && t >= 0.0 { t } else { f64::INFINITY }
    }
}

fn from_to(a: Point, b: Point) -> Point {
    Point::new(b.x_m - a.x_m, b.y_m - a.y_m)
}

fn cross(a: Point, b: Point) -> f64 {
    a.x_m * b.y_m - a.y_m * b.x_m
}

fn wall_corners([x0, y0, x1, y1]: [f64; 4]) -> Vec<Point> {
    let half = WALL_M / 2.0;
    let (west, east, south, north) =
        (x0.min(x1) - half, x0.max(x1) + half, y0.min(y1) - half, y0.max(y1) + half);
    [(west, south), (east, south), (east, north), (west, north)].map(|(x, y)| Point::new(x, y)).to_vec()
}

fn box_corners([x, y, length, width, turn_deg]: [f64; 5]) -> Vec<Point> {
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
        .map(|(u, v)| (u * length, v * width))
        .map(|(u, v)| Point::new(x + cos * u - sin * v, y + sin * u + cos * v))
        .to_vec()
}

fn round_corners([x, y, radius]: [f64; 3]) -> Vec<Point> {
    let corner = |i: u32| f64::from(i) * TAU / 8.0;
    (0..8).map(corner).map(|angle| Point::new(x + radius * angle.cos(), y + radius * angle.sin())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_end_at_the_faces_of_walls() {
        let plan = FloorPlan::built_in();
        let from = Point::new(7.0, 6.8);
        let east = Point::new(1.0, 0.0);
        assert_eq!(plan.cast(from, Point::new(0.0, -1.0), 20.0), Some(6.8 - 6.1));
        assert!((plan.cast(from, east, 40.0).unwrap() - (29.9 - 7.0)).abs() < 1e-9);
        assert_eq!(plan.cast(from, east, 12.0), None);
    }

    #[test]
    fn no_beam_leaves_the_building() {
        let plan = FloorPlan::built_in();
        for point in plan.way_points() {
            for i in 0..720 {
                let (sin, cos) = (f64::from(i) * TAU / 720.0 + 1e-3).sin_cos();
                assert!(plan.cast(*point, Point::new(cos, sin), 40.0).is_some(), "{point:?} {i}");
            }
        }
    }
}
