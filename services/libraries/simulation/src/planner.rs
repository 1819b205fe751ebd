//! Plans ways that keep clear of walls: A* on a grid (Hart, Nilsson and Raphael 1968), then smoothing.

use flockslam_geometry::Point;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Nearer to a wall than this the robot does not plan to go, metres.
const CLEARANCE_M: f64 = 0.35;
/// Farther away than this it does not care, metres.
const COMFORT_M: f64 = 0.7;
/// How many times longer a way is worth that avoids the closest passage.
const DETOUR: u32 = 3;
/// Cost of a step along an axis and along a diagonal.
const STEP: (u32, u32) = (10, 14);
/// Points on each side over which a path is averaged.
const SMOOTHING: usize = 4;

/// Free space with its distances to the walls, in which ways are searched.
#[derive(Clone, Debug)]
pub(super) struct PlanningGrid {
    width: usize,
    height: usize,
    cell_m: f64,
    /// Per cell what a step of cost 1 costs there; 0 where the robot does not fit.
    cost_of_cell: Vec<u8>,
}

impl PlanningGrid {
    /// A grid from its solid cells, row by row. Outside is solid.
    pub(super) fn new(width: usize, height: usize, cell_m: f64, solid: Vec<bool>) -> Self {
        let scale_m = cell_m / f64::from(STEP.0);
        let to_cost = |clearance: u8| {
            let clearance_m = f64::from(clearance) * scale_m;
            let discomfort = ((COMFORT_M - clearance_m) / (COMFORT_M - CLEARANCE_M)).clamp(0.0, 1.0);
            let cost_of_cell = 10 + (f64::from(10 * DETOUR) * discomfort) as u8;
            if clearance_m >= CLEARANCE_M { cost_of_cell } else { 0 }
        };
        let mut cost_of_cell = clearances(width, height, &solid);
        cost_of_cell.iter_mut().for_each(|cell| *cell = to_cost(*cell));
        Self { width, height, cell_m, cost_of_cell }
    }

    /// A smooth way between two points, about one point for each cell; `None` when there is none. (A*: Hart, Nilsson and
    /// Raphael 1968.)
    pub(super) fn path(&self, from: Point, to: Point) -> Option<Vec<Point>> {
        let (start, goal) = (self.cell_at(from)?, self.cell_at(to)?);
        let mut seen = Seen::new(self.width, self.height);
        let mut open = BinaryHeap::from([(Reverse(self.least_cost(start, goal)), start)]);
        seen.set(start, Step { cost: 0, came_from: usize::MAX });
        while let Some((Reverse(estimate), cell)) = open.pop() {
            if cell == goal {
                return Some(smooth(&self.trace(&seen, goal)));
            }
            let so_far = seen.get(cell).cost;
            if estimate > so_far.saturating_add(self.least_cost(cell, goal)) {
                continue;
            }
            for (neighbour, step) in self.neighbours(cell) {
                if self.cost_of_cell[neighbour] == 0 {
                    continue;
                }
                let cost = so_far + step * u32::from(self.cost_of_cell[neighbour]);
                if cost < seen.get(neighbour).cost {
                    seen.set(neighbour, Step { cost, came_from: cell });
                    open.push((Reverse(cost + self.least_cost(neighbour, goal)), neighbour));
                }
            }
        }
        None
    }

    /// The cells of the largest connected free space.
    pub(super) fn largest_room(&self) -> Vec<u32> {
        let mut seen = vec![false; self.cost_of_cell.len()];
        let mut largest = Vec::new();
        for start in 0..self.cost_of_cell.len() {
            if self.cost_of_cell[start] != 0 && !seen[start] {
                let room = self.flood(start, &mut seen);
                if room.len() > largest.len() {
                    largest = room;
                }
            }
        }
        largest.shrink_to_fit();
        largest
    }

    /// The cells that can be reached from a point; none when the robot does not fit there.
    pub(super) fn room_around(&self, point: Point) -> Vec<u32> {
        let mut seen = vec![false; self.cost_of_cell.len()];
        let start = self.cell_at(point);
        let mut room = start.map_or_else(Vec::new, |start| self.flood(start, &mut seen));
        room.shrink_to_fit();
        room
    }

    fn flood(&self, start: usize, seen: &mut [bool]) -> Vec<u32> {
        // A world of more cells would fill the memory.
        let number = |cell: usize| u32::try_from(cell).expect("a world has fewer than 2^32 cells");
        let (mut room, mut next) = (vec![number(start)], 0);
        seen[start] = true;
        while next < room.len() {
            for (neighbour, _) in self.neighbours(room[next] as usize) {
                if self.cost_of_cell[neighbour] != 0 && !seen[neighbour] {
                    seen[neighbour] = true;
                    room.push(number(neighbour));
                }
            }
            next += 1;
        }
        room
    }

    fn neighbours(&self, cell: usize) -> impl Iterator<Item = (usize, u32)> {
        let (x, y) = ((cell % self.width) as i64, (cell / self.width) as i64);
        let around =
            (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))).filter(|offset| *offset != (0, 0));
        around.filter_map(move |(dx, dy): (i64, i64)| {
            let (x, y) = (usize::try_from(x + dx).ok()?, usize::try_from(y + dy).ok()?);
            let step = if dx == 0 || dy == 0 { STEP.0 } else { STEP.1 };
            (x < self.width && y < self.height).then_some((y * self.width + x, step))
        })
    }

    /// What the way between two cells costs at least: the octile distance without tolls.
    fn least_cost(&self, from: usize, to: usize) -> u32 {
        let dx = (from % self.width).abs_diff(to % self.width) as u32;
        let dy = (from / self.width).abs_diff(to / self.width) as u32;
        10 * (STEP.0 * dx.abs_diff(dy) + STEP.1 * dx.min(dy))
    }

    fn trace(&self, seen: &Seen, goal: usize) -> Vec<Point> {
        let cells = std::iter::successors(Some(goal), |cell| {
            Some(seen.get(*cell).came_from).filter(|from| *from != usize::MAX)
        });
        let mut points: Vec<Point> = cells.map(|cell| self.centre(cell)).collect();
        points.reverse();
        points
    }

    /// Centre of a cell.
    pub(super) fn centre(&self, cell: usize) -> Point {
        let centre = |index: usize| (index as f64 + 0.5) * self.cell_m;
        Point::new(centre(cell % self.width), centre(cell / self.width))
    }

    fn cell_at(&self, point: Point) -> Option<usize> {
        let (x, y) = ((point.x_m / self.cell_m).floor(), (point.y_m / self.cell_m).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        let cell = inside.then(|| y as usize * self.width + x as usize)?;
        (self.cost_of_cell[cell] != 0).then_some(cell)
    }
}

/// How the search came to a cell.
#[derive(Clone, Copy)]
struct Step {
    /// Cost of the best way so far; the greatest number before there is one.
    cost: u32,
    came_from: usize,
}

/// Not reached yet.
const UNREACHED: Step = Step { cost: u32::MAX, came_from: usize::MAX };
/// Cells along a side of a block.
const BLOCK_SIDE: usize = 16;

/// The cells that a search has reached. A world is much larger than its ways, so memory is taken by blocks as they are reached.
struct Seen {
    width: usize,
    blocks_in_row: usize,
    blocks: Vec<Option<Box<[Step; BLOCK_SIDE * BLOCK_SIDE]>>>,
}

impl Seen {
    fn new(width: usize, height: usize) -> Self {
        let (blocks_in_row, rows) = (width.div_ceil(BLOCK_SIDE), height.div_ceil(BLOCK_SIDE));
        Self { width, blocks_in_row, blocks: vec![None; blocks_in_row * rows] }
    }

    /// The block of a cell, and its place there.
    fn place(&self, cell: usize) -> (usize, usize) {
        let (x, y) = (cell % self.width, cell / self.width);
        (y / BLOCK_SIDE * self.blocks_in_row + x / BLOCK_SIDE, y % BLOCK_SIDE * BLOCK_SIDE + x % BLOCK_SIDE)
    }

    fn get(&self, cell: usize) -> Step {
        let (block, place) = self.place(cell);
        self.blocks[block].as_ref().map_or(UNREACHED, |steps| steps[place])
    }

    fn set(&mut self, cell: usize, step: Step) {
        let (block, place) = self.place(cell);
        let steps = self.blocks[block].get_or_insert_with(|| Box::new([UNREACHED; BLOCK_SIDE * BLOCK_SIDE]));
        steps[place] = step;
    }
}

/// Distance of each cell from the next solid one, in steps, at most 255: two sweeps of a chamfer mask (Borgefors 1986).
fn clearances(width: usize, height: usize, solid: &[bool]) -> Vec<u8> {
    let mut clearance: Vec<u8> = solid.iter().map(|solid| if *solid { 0 } else { u8::MAX }).collect();
    let cells = width * height;
    for backward in [false, true] {
        for i in 0..cells {
            let cell = if backward { cells - 1 - i } else { i };
            let (x, y) = ((cell % width) as i64, (cell / width) as i64);
            let ahead = if backward { 1 } else { -1 };
            for (dx, dy, step) in
                [(ahead, 0, STEP.0), (-1, ahead, STEP.1), (0, ahead, STEP.0), (1, ahead, STEP.1)]
            {
                let (x, y) = (x + dx, y + dy);
                let inside = x >= 0 && y >= 0 && x < width as i64 && y < height as i64;
                let there = if inside { clearance[y as usize * width + x as usize] } else { 0 };
                clearance[cell] = clearance[cell].min(there.saturating_add(step as u8));
            }
        }
    }
    clearance
}

/// A moving average; both ends stay.
fn smooth(points: &[Point]) -> Vec<Point> {
    let average = |i: usize| {
        let reach = SMOOTHING.min(i).min(points.len() - 1 - i);
        let window = &points[i - reach..=i + reach];
        let sum = window.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.x_m, sum.1 + point.y_m));
        Point::new(sum.0 / window.len() as f64, sum.1 / window.len() as f64)
    };
    (0..points.len()).map(average).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rooms of 5 × 5 m, a wall at x = 5 m with a door of 1.2 m at y = 4 m when `door`.
    fn rooms(door: bool) -> PlanningGrid {
        let solid = (0..100 * 50)
            .map(|i| (i % 100, i / 100))
            .map(|(x, y)| x == 50 && !(door && (34..46).contains(&y)));
        PlanningGrid::new(100, 50, 0.1, solid.collect())
    }

    #[test]
    fn ways_lead_through_the_middle_of_doors_and_end_where_there_is_none() {
        let (from, to) = (Point::new(2.0, 1.0), Point::new(8.0, 1.0));
        let path = rooms(true).path(from, to).unwrap();
        assert!(path[0].distance_m(from) < 0.1 && path[path.len() - 1].distance_m(to) < 0.1);
        let at_door = path.iter().find(|point| point.x_m > 5.0).unwrap();
        assert!((3.8..=4.2).contains(&at_door.y_m), "{at_door:?}");
        assert!(path.windows(2).all(|step| step[0].distance_m(step[1]) < 0.15));
        assert!(rooms(false).path(from, to).is_none());
    }

    #[test]
    fn the_largest_room_is_all_that_can_be_reached() {
        assert!(rooms(true).largest_room().len() > 2 * rooms(false).largest_room().len());
        assert!(PlanningGrid::new(3, 3, 0.1, vec![true; 9]).largest_room().is_empty());
    }
}
