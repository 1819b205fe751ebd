//! Simulated scans in an imported map: places to look from, and the ranges from each.

use flockslam_evidence::CellState;
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_messages::ScanBuffer;
use flockslam_results::StoredMap;
use std::f64::consts::TAU;

/// One place to look from in each square of this side, metres: where loops are closed, some see each wall.
const SQUARE_M: f64 = 1.5;
/// A robot is at least so far from what is not free, metres.
const CLEARANCE_M: f64 = 0.25;
/// Beams of a view, evenly around: 0.13 m apart at the greatest range.
const BEAMS: usize = 720;
/// Walls farther than this are not seen, metres: points beyond close no loops.
const RANGE_MAX_M: f64 = 15.0;
/// A place from which fewer beams than this meet a wall says nothing, as one outside of a building that is drawn on white.
const HITS_MIN: usize = 72;

/// A map in memory, cell by cell.
pub struct Plan {
    width: usize,
    height: usize,
    cell_size_m: f64,
    origin: Point,
    states: Vec<CellState>,
}

impl Plan {
    /// The states of a map's cells.
    pub fn new(map: &StoredMap) -> Self {
        let mut states = Vec::with_capacity(map.width * map.height);
        map.for_each_row(|row| states.extend(row.iter().map(CellState::of)));
        let StoredMap { width, height, cell_size_m, origin, .. } = *map;
        Self { width, height, cell_size_m, origin, states }
    }

    /// Lower left and upper right corner, metres.
    pub fn corners(&self) -> (Point, Point) {
        let far = |from: f64, cells: usize| from + cells as f64 * self.cell_size_m;
        (self.origin, Point::new(far(self.origin.x_m, self.width), far(self.origin.y_m, self.height)))
    }

    /// Column and row of a place.
    fn cell(&self, at: Point) -> (i64, i64) {
        let index = |metres: f64| (metres / self.cell_size_m).floor() as i64;
        (index(at.x_m - self.origin.x_m), index(at.y_m - self.origin.y_m))
    }

    /// Unknown outside of the map.
    fn state(&self, (x, y): (i64, i64)) -> CellState {
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        if inside { self.states[y as usize * self.width + x as usize] } else { CellState::Unknown }
    }

    /// The middle of a cell.
    fn middle(&self, (x, y): (i64, i64)) -> Point {
        let along = |from: f64, cell: i64| from + (cell as f64 + 0.5) * self.cell_size_m;
        Point::new(along(self.origin.x_m, x), along(self.origin.y_m, y))
    }

    /// What the map says of a square of this side around a place: that it is occupied when any cell with its middle in it is, else what
    /// the cell under the place is.
    pub fn state_around(&self, at: Point, side_m: f64) -> CellState {
        let own = self.state(self.cell(at));
        if own == CellState::Occupied || side_m <= self.cell_size_m {
            return own;
        }
        let half_m = 0.5 * side_m;
        let (low, high) = (
            self.cell(Point::new(at.x_m - half_m, at.y_m - half_m)),
            self.cell(Point::new(at.x_m + half_m, at.y_m + half_m)),
        );
        let is_in = |cell: (i64, i64)| {
            let middle = self.middle(cell);
            (middle.x_m - at.x_m).abs() < half_m && (middle.y_m - at.y_m).abs() < half_m
        };
        let around = (low.1..=high.1).flat_map(|y| (low.0..=high.0).map(move |x| (x, y)));
        let meets = around.filter(|cell| is_in(*cell)).any(|cell| self.state(cell) == CellState::Occupied);
        if meets { CellState::Occupied } else { own }
    }

    /// Steps from cell to neighbouring cell up to what is not free, by cell.
    fn clearances(&self) -> Vec<u16> {
        let mut steps: Vec<u16> = self
            .states
            .iter()
            .map(|state| if *state == CellState::Free { u16::MAX - 1 } else { 0 })
            .collect();
        let (width, height) = (self.width, self.height);
        let lower = |steps: &mut Vec<u16>, at: usize, other: Option<usize>| {
            let near = other.map_or(0, |other| steps[other]);
            steps[at] = steps[at].min(near + 1);
        };
        for at in 0..width * height {
            let (x, y) = (at % width, at / width);
            lower(&mut steps, at, (x > 0).then(|| at - 1));
            lower(&mut steps, at, (y > 0).then(|| at - width));
        }
        for at in (0..width * height).rev() {
            let (x, y) = (at % width, at / width);
            lower(&mut steps, at, (x + 1 < width).then_some(at + 1));
            lower(&mut steps, at, (y + 1 < height).then_some(at + width));
        }
        steps
    }

    /// Places to look from, each with what a lidar sees there: the widest one of each square, where a robot has room and a wall in sight.
    pub fn views(&self) -> Vec<(Pose, ScanBuffer)> {
        let clearances = self.clearances();
        let side = ((SQUARE_M / self.cell_size_m).round() as usize).max(1);
        let clear_cells = (CLEARANCE_M / self.cell_size_m).ceil() as u16;
        let mut views = Vec::new();
        for y in (0..self.height).step_by(side) {
            for x in (0..self.width).step_by(side) {
                let columns = x..(x + side).min(self.width);
                let rows = y..(y + side).min(self.height);
                let cells = rows.flat_map(|y| columns.clone().map(move |x| (x, y)));
                // Of those equally wide the one nearest to the middle of the square.
                let off =
                    |(cx, cy): (usize, usize)| (cx.abs_diff(x + side / 2)).max(cy.abs_diff(y + side / 2));
                let clearance = |(x, y): (usize, usize)| clearances[y * self.width + x].min(2 * clear_cells);
                let best = cells.max_by_key(|cell| (clearance(*cell), std::cmp::Reverse(off(*cell))));
                let Some(cell) = best.filter(|cell| clearance(*cell) >= clear_cells) else { continue };
                let at = self.middle((cell.0 as i64, cell.1 as i64));
                let scan = self.scan(at);
                if (0..BEAMS).filter(|beam| scan.numbers[*beam].is_finite()).count() >= HITS_MIN {
                    views.push((Pose::new(at.x_m, at.y_m, 0.0), scan));
                }
            }
        }
        views
    }

    /// The scan from a place, ahead along x.
    fn scan(&self, from: Point) -> ScanBuffer {
        let increment_rad = TAU / BEAMS as f64;
        let range = |beam: usize| {
            let (sin, cos) = sin_cos(beam as f64 * increment_rad - TAU / 2.0);
            self.range_m(from, Point::new(cos, sin)).map_or(f32::INFINITY, |range_m| range_m as f32)
        };
        let ranges: Vec<f32> = (0..BEAMS).map(range).collect();
        let mut scan = ScanBuffer::from_ranges(&ranges, -TAU / 2.0, increment_rad);
        scan.header.range_max_m = RANGE_MAX_M as f32;
        scan
    }

    /// The way along a beam to the middle of the first occupied cell that it meets; `None` when it meets none before what is unknown.
    fn range_m(&self, from: Point, direction: Point) -> Option<f64> {
        let step_m = 0.25 * self.cell_size_m;
        let steps = (RANGE_MAX_M / step_m) as u32;
        for step in 1..steps {
            let along_m = f64::from(step) * step_m;
            let at = Point::new(from.x_m + along_m * direction.x_m, from.y_m + along_m * direction.y_m);
            let cell = self.cell(at);
            match self.state(cell) {
                CellState::Free => {}
                CellState::Unknown => return None,
                CellState::Occupied => {
                    let middle = self.middle(cell);
                    let (dx, dy) = (middle.x_m - from.x_m, middle.y_m - from.y_m);
                    return Some(dx * direction.x_m + dy * direction.y_m);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::Cell;

    /// A room of 6 × 4 m with walls of one cell, drawn on nothing.
    fn room(outside: Cell) -> StoredMap {
        let (free, wall) = (Cell::from_weights(0.0, 4.0), Cell::from_weights(4.0, 0.0));
        let mut map = StoredMap::of_width(140, 0.05, Point::new(-3.5, -2.5));
        for y in 0..100 {
            let cell = |x: usize| {
                let is_inside = (10..130).contains(&x) && (10..90).contains(&y);
                let is_wall = is_inside && (x == 10 || x == 129 || y == 10 || y == 89);
                if is_wall {
                    wall
                } else if is_inside {
                    free
                } else {
                    outside
                }
            };
            map.push_row(&(0..140).map(cell).collect::<Vec<_>>());
        }
        map
    }

    #[test]
    fn a_lidar_sees_the_walls_of_a_plan_from_places_with_room() {
        for outside in [Cell::UNKNOWN, Cell::from_weights(0.0, 4.0)] {
            let plan = Plan::new(&room(outside));
            let views = plan.views();
            assert!((8..=30).contains(&views.len()), "{}", views.len());
            let inside = |pose: &Pose| pose.x_m.abs() < 2.7 && pose.y_m.abs() < 1.7;
            let views: Vec<_> = views.iter().filter(|(pose, _)| inside(pose)).collect();
            assert!(views.len() >= 8, "{}", views.len());
            for (pose, scan) in views {
                for beam in 0..BEAMS {
                    let (sin, cos) = sin_cos(beam as f64 * TAU / BEAMS as f64 - TAU / 2.0);
                    let range_m = f64::from(scan.numbers[beam]);
                    let (x, y) = (pose.x_m + range_m * cos, pose.y_m + range_m * sin);
                    // Walls lie in cells whose middles are 2.975 and 1.975 m from the middle.
                    let off_m = (x.abs() - 2.975).abs().min((y.abs() - 1.975).abs());
                    assert!(off_m < 0.05, "{x} {y}");
                }
            }
        }
    }

    #[test]
    fn thin_walls_stay_where_cells_are_larger() {
        let plan = Plan::new(&room(Cell::UNKNOWN));
        for step in 0..20 {
            let x_m = -3.2 + 0.02 * f64::from(step);
            let expected = if (-3.05..-2.9).contains(&x_m) { Some(CellState::Occupied) } else { None };
            let found = plan.state_around(Point::new(x_m, 0.0), 0.16);
            assert!(expected.is_none_or(|expected| found == expected), "{x_m}: {found:?}");
        }
    }
}
