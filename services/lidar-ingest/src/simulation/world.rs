use super::floor_plan::FloorPlan;
use super::planner::PlanningGrid;
use super::{ImageWorld, SimulationError};
use crate::random::Random;
use flockslam_geometry::Point;

/// Shortest way between two random way points, metres.
const LEG_MIN_M: f64 = 3.0;
/// Each so many random way points one is taken that was visited before.
const REVISIT_EVERY: usize = 3;

/// What the robot drives through.
#[derive(Clone, Debug)]
pub enum World {
    /// The built-in building, 30 × 20 m.
    FloorPlan(FloorPlan),
    /// A map image.
    Image(ImageWorld),
}

impl World {
    /// The built-in building: two corridors and two halls around a block, nine rooms, pillars and furniture.
    pub fn floor_plan() -> Self {
        Self::FloorPlan(FloorPlan::built_in())
    }

    /// Distance from a point to what a beam in `direction` (a unit vector) hits first, metres; `None` when nothing is
    /// within `max_m`.
    pub fn cast(&self, from: Point, direction: Point, max_m: f64) -> Option<f64> {
        match self {
            Self::FloorPlan(plan) => plan.cast(from, direction, max_m),
            Self::Image(image) => image.cast(from, direction, max_m),
        }
    }

    /// A way of at least `length_m` metres, clear of walls, that returns to places visited before.
    pub(super) fn tour(&self, length_m: f64, random: &mut Random) -> Result<Vec<Point>, SimulationError> {
        match self {
            Self::FloorPlan(plan) => guided_tour(&plan.planning_grid(), plan.way_points(), length_m),
            Self::Image(image) => random_tour(&image.planning_grid(), length_m, random),
        }
    }
}

/// Visits the given points in their order, again and again.
fn guided_tour(grid: &PlanningGrid, points: &[Point], length_m: f64) -> Result<Vec<Point>, SimulationError> {
    let round: Vec<Point> = points
        .iter()
        .zip(points.iter().cycle().skip(1))
        .map(|(from, to)| grid.path(*from, *to).ok_or(SimulationError::NoRoom))
        .collect::<Result<Vec<_>, _>>()?
        .concat();
    let rounds = (length_m / path_length_m(&round)).ceil().max(1.0) as usize;
    Ok(round.repeat(rounds))
}

/// Visits random points, and every now and then one of those again.
fn random_tour(
    grid: &PlanningGrid,
    length_m: f64,
    random: &mut Random,
) -> Result<Vec<Point>, SimulationError> {
    let room = grid.largest_room();
    if room.len() < 2 {
        return Err(SimulationError::NoRoom);
    }
    let mut visited = vec![room[random.below(room.len())]];
    let (mut tour, mut driven_m) = (Vec::new(), 0.0);
    // Bounded: a leg is never empty, and short ones are rare in a world of any size.
    while driven_m < length_m && visited.len() < 100_000 {
        let again = visited.len().is_multiple_of(REVISIT_EVERY);
        let next = if again { visited[random.below(visited.len())] } else { room[random.below(room.len())] };
        let last = *visited.last().expect("the start is in it");
        visited.push(last);
        if last.distance_m(next) < LEG_MIN_M && room.len() > 10_000 {
            continue;
        }
        let leg = grid.path(last, next).ok_or(SimulationError::NoRoom)?;
        driven_m += path_length_m(&leg);
        tour.extend(leg);
        *visited.last_mut().expect("the start is in it") = next;
    }
    if driven_m > 0.0 { Ok(tour) } else { Err(SimulationError::NoRoom) }
}

fn path_length_m(path: &[Point]) -> f64 {
    path.windows(2).map(|step| step[0].distance_m(step[1])).sum()
}
