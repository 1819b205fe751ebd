//! A room as a score field, for tests: scores fall off smoothly with the distance to the nearest wall.

use crate::field::GridField;
use flockslam_evidence::{CellIndex, TILE_CELLS, Tile, TileGrid, TileKey};
use flockslam_geometry::{Point, Pose};

/// A grid whose walls are the lines `walls`: (normal x, normal y, offset), each a line n·p = offset.
pub fn grid(walls: &[(f64, f64, f64)]) -> TileGrid<Box<Tile>> {
    let mut grid = TileGrid::new(0.05);
    for (x, y) in (-3..3).flat_map(|x| (-3..3).map(move |y| (x, y))) {
        let key = TileKey { x, y };
        let mut tile = Tile::unknown(0);
        for offset in 0..TILE_CELLS {
            let cell: CellIndex = key.cell(offset);
            let center = grid.center(cell);
            let distance = walls.iter().map(|w| (w.0 * center.x_m + w.1 * center.y_m - w.2).abs());
            let nearest = distance.fold(f64::INFINITY, f64::min);
            tile.set_score(offset, (65_535.0 * (-0.5 * (nearest / 0.06).powi(2)).exp()) as u16);
        }
        grid.set(key, tile).expect("near");
    }
    grid
}

/// A room of 6 × 4 m whose corners make all poses distinguishable. (Walls on the edge between two cells would have no slope.)
pub const ROOM: [(f64, f64, f64); 4] =
    [(1.0, 0.0, 4.03), (1.0, 0.0, -1.98), (0.0, 1.0, 1.54), (0.0, 1.0, -2.47)];

/// The scan of a lidar at `pose` in [`ROOM`]: points in its own frame.
pub fn scan(pose: Pose) -> Vec<Point> {
    let beam = |angle: f64| {
        let (sin, cos) = (pose.heading_rad + angle).sin_cos();
        let hit = |(nx, ny, offset): (f64, f64, f64)| {
            let range = (offset - nx * pose.x_m - ny * pose.y_m) / (nx * cos + ny * sin);
            if range > 0.0 { range } else { f64::INFINITY }
        };
        let range = ROOM.iter().map(|wall| hit(*wall)).fold(f64::INFINITY, f64::min);
        Point::new(range * angle.cos(), range * angle.sin())
    };
    (0..180).map(|i| beam(f64::from(i) * 0.0349)).collect()
}

/// The field of a grid, unknown outside.
pub fn field(grid: &TileGrid<Box<Tile>>) -> GridField<'_, Box<Tile>> {
    GridField::new(grid, 0.0)
}
