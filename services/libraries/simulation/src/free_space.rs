//! Connected free space of a world: random places in it and ways between them.

use super::planner::PlanningGrid;
use flockslam_geometry::Point;
use flockslam_random::Random;

/// Places that are drawn until one is suitable.
const DRAWS_MAX: usize = 100;

/// Connected free space: all places that can be reached from each other, and the ways between them.
#[derive(Clone, Debug)]
pub(super) struct FreeSpace {
    grid: PlanningGrid,
    /// Its cells.
    cells: Vec<u32>,
}

impl FreeSpace {
    /// The free space around a point; without places when no body fits there.
    pub(super) fn around(grid: PlanningGrid, point: Point) -> Self {
        let cells = grid.room_around(point);
        Self { grid, cells }
    }

    /// The largest free space of a world.
    pub(super) fn largest(grid: PlanningGrid) -> Self {
        let cells = grid.largest_room();
        Self { grid, cells }
    }

    /// Number of its places, the centres of its cells.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// One of its places by its number.
    pub(super) fn place(&self, number: usize) -> Point {
        self.grid.centre(self.cells[number] as usize)
    }

    /// All its places.
    pub(super) fn places(&self) -> impl Iterator<Item = Point> {
        (0..self.len()).map(|number| self.place(number))
    }

    /// The place nearest to a point.
    pub(super) fn nearest(&self, to: Point) -> Point {
        let by_distance = |a: &Point, b: &Point| a.distance_m(to).total_cmp(&b.distance_m(to));
        self.places().min_by(by_distance).expect("a room has places")
    }

    /// The way between two of its places, about one point for each cell.
    pub(super) fn way(&self, from: Point, to: Point) -> Vec<Point> {
        self.grid.path(from, to).expect("both are in the same room")
    }

    /// A place, if possible at least `apart_m` metres from `from`.
    pub(super) fn place_away_from(&self, from: Point, apart_m: f64, random: &mut Random) -> Point {
        self.place_where(random, |place| place.distance_m(from) >= apart_m)
    }

    /// A place, if possible one that `suits`.
    pub(super) fn place_where(&self, random: &mut Random, suits: impl Fn(Point) -> bool) -> Point {
        let mut draw = || self.place(random.below(self.len()));
        let first = draw();
        let mut others = std::iter::repeat_with(draw).take(DRAWS_MAX);
        if suits(first) { first } else { others.find(|place| suits(*place)).unwrap_or(first) }
    }
}
