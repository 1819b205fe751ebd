//! How much of a scan contradicts the grid at a pose, and how much is where nothing is known.

use flockslam_evidence::{TILE_SIDE, Tile, TileGrid, WEIGHT_SCALE};
use flockslam_geometry::{Point, Pose};
use std::ops::Deref;

/// Evidence for "free" from which a cell is known to be free, nat: a few beams went through.
const FREE_NAT: f64 = 1.0;

/// Share of the points, seen from `pose`, that end in space known to be free with nothing occupied close by.
///
/// A scan of a place that is new ends where nothing is known; a scan in the wrong place ends in free space.
pub(crate) fn contradicted<H: Deref<Target = Tile>>(grid: &TileGrid<H>, points: &[Point], pose: Pose) -> f64 {
    let ends_in_free = |point: &&Point| {
        let cell = grid.cell_at(pose.apply(**point));
        grid.tile(cell.tile()).is_some_and(|tile| is_free(tile, cell.offset()))
    };
    points.iter().filter(ends_in_free).count() as f64 / points.len().max(1) as f64
}

/// Share of the points, seen from `pose`, that end in unknown cells.
pub(crate) fn unknown_share<H: Deref<Target = Tile>>(
    grid: &TileGrid<H>,
    points: &[Point],
    pose: Pose,
) -> f64 {
    let is_unknown = |point: &&Point| {
        let cell = grid.cell_at(pose.apply(**point));
        grid.tile(cell.tile()).is_none_or(|tile| {
            let cell = tile.cells[cell.offset()];
            cell.free == 0 && cell.occupied == 0
        })
    };
    points.iter().filter(is_unknown).count() as f64 / points.len().max(1) as f64
}

fn is_free(tile: &Tile, offset: usize) -> bool {
    let block = (offset / TILE_SIDE / 4) * (TILE_SIDE / 4) + offset % TILE_SIDE / 4;
    f64::from(tile.cells[offset].free) >= FREE_NAT * WEIGHT_SCALE && tile.score_quarter[block] == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{Cell, TileKey};

    #[test]
    fn only_ends_in_known_free_space_contradict() {
        let mut tile = Tile::unknown(0);
        tile.cells[..TILE_SIDE * 32].fill(Cell::from_weights(0.0, 2.0).pack());
        tile.set_score(4, 60_000);
        let mut grid = TileGrid::new(0.05);
        grid.set(TileKey { x: 0, y: 0 }, tile).unwrap();
        // Free; free beside something occupied; unknown; outside of the grid.
        let points = [(2.0, 1.0), (0.3, 0.1), (2.0, 2.0), (2.0, -2.0)].map(|(x, y)| Point::new(x, y));
        assert_eq!(contradicted(&grid, &points, Pose::IDENTITY), 0.25);
        assert_eq!(contradicted(&grid, &[], Pose::IDENTITY), 0.0);
        assert_eq!(unknown_share(&grid, &points, Pose::IDENTITY), 0.5);
    }
}
