//! The robot's way without end: legs between given points or random ones.

use super::SimulationError;
use super::free_space::FreeSpace;
use super::planner::PlanningGrid;
use flockslam_geometry::Point;
use flockslam_random::Random;
use std::sync::Arc;

/// Shortest way between two random way points, metres.
const LEG_MIN_M: f64 = 3.0;
/// Rooms of fewer cells than this are too small to be choosy about the length of a leg.
const ROOMY_CELLS: usize = 10_000;
/// Each so many random way points one is taken that was visited before.
const REVISIT_EVERY: usize = 3;
/// A room whose places all lie nearer to each other than this is none to drive in, metres.
const EXTENT_MIN_M: f64 = 1.0;
/// Visited way points that are kept.
const VISITED_MAX: usize = 4096;

/// A way without end, clear of walls, that returns to places visited before; planned leg by leg.
#[derive(Clone, Debug)]
pub(super) struct Tour {
    /// All places that can be reached from the tour.
    room: Arc<FreeSpace>,
    plan: Plan,
}

#[derive(Clone, Debug)]
enum Plan {
    /// Given points in their order, again and again.
    Guided { points: Vec<Point>, legs: Vec<Vec<Point>>, next: usize },
    /// Random points, and every now and then one of those again.
    Random { visited: Vec<Point>, count: usize, random: Random },
}

impl Tour {
    /// Visits the given points in their order, again and again.
    pub(super) fn guided(grid: PlanningGrid, points: &[Point]) -> Result<Self, SimulationError> {
        let ends = points.iter().zip(points.iter().cycle().skip(1));
        let legs = ends
            .map(|(from, to)| grid.path(*from, *to))
            .collect::<Option<_>>()
            .ok_or(SimulationError::NoRoom)?;
        let room = Arc::new(FreeSpace::around(grid, points[0]));
        Ok(Self { room, plan: Plan::Guided { points: points.to_vec(), legs, next: 0 } })
    }

    /// Visits random points of the largest room, and every now and then one of those again.
    pub(super) fn random(grid: PlanningGrid, mut random: Random) -> Result<Self, SimulationError> {
        let room = Arc::new(FreeSpace::largest(grid));
        if !room.places().any(|place| place.distance_m(room.place(0)) >= EXTENT_MIN_M) {
            return Err(SimulationError::NoRoom);
        }
        let visited = vec![room.place(random.below(room.len()))];
        Ok(Self { room, plan: Plan::Random { visited, count: 1, random } })
    }

    /// The way to the next point, about one point for each cell; never empty.
    pub(super) fn next_leg(&mut self) -> Vec<Point> {
        match &mut self.plan {
            Plan::Guided { legs, next, .. } => {
                let leg = legs[*next].clone();
                *next = (*next + 1) % legs.len();
                leg
            }
            Plan::Random { visited, count, random } => loop {
                let again = count.is_multiple_of(REVISIT_EVERY);
                let known = visited.len();
                let next = if again {
                    visited[random.below(known)]
                } else {
                    self.room.place(random.below(self.room.len()))
                };
                let last = visited[(*count - 1) % VISITED_MAX];
                mark_visited(visited, count, last);
                if last.distance_m(next) < LEG_MIN_M && self.room.len() > ROOMY_CELLS {
                    continue;
                }
                visited[(*count - 1) % VISITED_MAX] = next;
                break self.room.way(last, next);
            },
        }
    }

    /// The way from any place of the same room back onto the tour: to the point that comes next.
    pub(super) fn leg_from(&mut self, place: Point) -> Vec<Point> {
        match &mut self.plan {
            Plan::Guided { points, next, .. } => self.room.way(place, points[*next]),
            Plan::Random { visited, count, .. } => {
                mark_visited(visited, count, place);
                self.next_leg()
            }
        }
    }

    /// The free space that the tour leads through.
    pub(super) fn room(&self) -> &Arc<FreeSpace> {
        &self.room
    }
}

/// Appends a visited point; beyond [`VISITED_MAX`] in the place of the oldest.
fn mark_visited(visited: &mut Vec<Point>, count: &mut usize, point: Point) {
    if visited.len() < VISITED_MAX {
        visited.push(point);
    } else {
        visited[*count % VISITED_MAX] = point;
    }
    *count += 1;
}
