//! Registers a scan against a grid that holds one other scan, in a simulated room, and compares the found pose with the
//! true one.
//!
//! Run it with `cargo run --release -p flockslam-registration --example register_scan`.

#![allow(clippy::disallowed_methods, reason = "no result depends on it")]

use flockslam_evidence::{Cell, CellIndex, Tile, TileGrid, TileKey};
use flockslam_geometry::{Point, Pose};
use flockslam_ray_insertion::{ObservedCells, SensorModel};
use flockslam_registration::{Correlative, GridField, Window};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Side of a cell, metres.
const CELL_M: f64 = 0.05;
/// Beams of a scan, over the full circle.
const BEAMS: u32 = 720;
/// Corners of the room and of a cabinet in it, metres. No wall is parallel to the grid.
const ROOM: [(f64, f64); 5] = [(-2.1, -1.7), (2.4, -1.3), (2.2, 1.9), (0.3, 2.3), (-1.8, 1.5)];
const CABINET: [(f64, f64); 4] = [(0.9, 0.6), (1.4, 0.8), (1.2, 1.3), (0.7, 1.1)];

/// Range from `from` in a direction to the wall between two corners; infinite when the beam misses it.
fn range_to(from: Pose, (cos, sin): (f64, f64), [start, end]: [(f64, f64); 2]) -> f64 {
    let (wall_x, wall_y) = (end.0 - start.0, end.1 - start.1);
    let (x, y) = (start.0 - from.x_m, start.1 - from.y_m);
    let cross = cos * wall_y - sin * wall_x;
    let (range_m, share) = ((x * wall_y - y * wall_x) / cross, (x * sin - y * cos) / cross);
    // A beam that is parallel to the wall divides by zero: the share is then not a number in this range.
    if range_m > 0.0 && (0.0..=1.0).contains(&share) { range_m } else { f64::INFINITY }
}

/// Where the beams of a lidar at `pose` end, in its own frame. The room is closed, so each beam ends on a wall.
fn scan(pose: Pose) -> Vec<Point> {
    let sides = |corners: &'static [(f64, f64)]| {
        (0..corners.len()).map(move |i| [corners[i], corners[(i + 1) % corners.len()]])
    };
    let beam = |i: u32| {
        let angle_rad = TAU * f64::from(i) / f64::from(BEAMS);
        let (sin, cos) = (pose.heading_rad + angle_rad).sin_cos();
        let walls = sides(&ROOM).chain(sides(&CABINET));
        let range_m = walls.map(|wall| range_to(pose, (cos, sin), wall)).fold(f64::INFINITY, f64::min);
        Point::new(range_m * angle_rad.cos(), range_m * angle_rad.sin())
    };
    (0..BEAMS).map(beam).collect()
}

/// The evidence of one scan. Hits are given before misses: the first observation of a cell counts.
#[derive(Default)]
struct OneScan(BTreeMap<CellIndex, Cell>);

impl ObservedCells for OneScan {
    fn observe(&mut self, cell: CellIndex, evidence: Cell) {
        self.0.entry(cell).or_insert(evidence);
    }
}

/// A grid with the evidence of a scan taken at `pose`. The score of a cell is its mass on "occupied".
fn grid_of_scan(pose: Pose) -> TileGrid<Box<Tile>> {
    let model = SensorModel::new(Cell::from_weights(1.5, 0.0), Cell::from_weights(0.0, 0.3));
    let ends: Vec<Point> = scan(pose).into_iter().map(|point| pose.apply(point)).collect();
    let mut evidence = OneScan::default();
    model.insert(CELL_M, pose.position(), &ends, &mut evidence);
    let mut tiles: BTreeMap<TileKey, Box<Tile>> = BTreeMap::new();
    for (index, cell) in evidence.0 {
        let tile = tiles.entry(index.tile()).or_insert_with(|| Tile::unknown(0));
        tile.cells[index.offset()] = cell.pack();
        tile.set_score(index.offset(), (cell.masses().occupied * f64::from(u16::MAX)).round() as u16);
    }
    let mut grid = TileGrid::new(CELL_M);
    for (key, tile) in tiles {
        grid.set(key, tile).expect("all tiles of a room are near each other");
    }
    grid
}

fn main() {
    let first = Pose::new(-0.4, -0.2, 0.1);
    // The second scan is taken 20 cm and 5 degrees away; the prediction is that the robot has not moved.
    let truth = first * Pose::new(0.2, 0.0, 5f64.to_radians());
    let grid = grid_of_scan(first);
    let window = Window { center: first, reach_m: 0.25, reach_rad: 0.2 };
    let field = GridField::new(&grid, 0.0);
    let fit = Correlative::default().fit(&field, &scan(truth), window);

    let print = |name: &str, pose: Pose| {
        let heading_deg = pose.heading_rad.to_degrees();
        println!("{name:>10}: x {:7.4} m, y {:7.4} m, heading {heading_deg:7.3} degrees", pose.x_m, pose.y_m);
    };
    print("prediction", first);
    print("found", fit.pose);
    print("true", truth);
    let (off_m, off_deg) = (fit.pose.distance_m(truth), fit.pose.turn_rad(truth).to_degrees());
    let covariance = fit.covariance(0.3, 0.15);
    println!(
        "error {off_m:.4} m and {off_deg:.3} degrees; standard deviation {:.4} m",
        covariance.position_std_m()
    );
    println!("mean score {:.2} over {} points", fit.score, fit.points);
    assert!(off_m < 0.02 && off_deg < 0.5, "the found pose is off by {off_m} m and {off_deg} degrees");
}
