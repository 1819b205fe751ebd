//! Walks over the occupied cells of a grid around the lidar, within a wedge, in an order that is the same however the
//! circle is divided.

use crate::sector::Wedge;
use flockslam_evidence::{CellIndex, TILE_CELLS, TILE_SIDE, Tile, TileGrid, TileKey};
use flockslam_geometry::Point;
use std::f64::consts::FRAC_1_SQRT_2;
use std::ops::Deref;

/// A cell is taken for occupied when its score is above the middle: with both read-outs of the mapper the evidence for
/// "occupied" then outweighs that for "free".
const OCCUPIED_SCORE: u16 = u16::MAX / 2;
/// Cells along a side of the blocks whose greatest score a tile holds.
const BLOCK: usize = 4;
const BLOCKS: usize = TILE_SIDE / BLOCK;
/// Along a side of the parts of a tile that are left out as wholes: cells, blocks, and how many there are of them in a tile.
const PART: usize = 16;
const PART_BLOCKS: usize = PART / BLOCK;
const PARTS: usize = TILE_SIDE / PART;

/// The cells that a scan may classify.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reach {
    pub around: Point,
    pub radius_m: f64,
    pub wedge: Wedge,
}

/// Calls `visit` for each occupied cell with its centre within reach, in a fixed order: with the cell, its centre, and its place in
/// that order among all cells that could be within the radius, whatever the wedge. Those in rectangles that `hides` names, which is given
/// two corners as seen from the middle, may be left out.
pub(crate) fn for_each_occupied<H: Deref<Target = Tile>>(
    grid: &TileGrid<H>,
    reach: Reach,
    hides: impl Fn(Point, Point) -> bool,
    mut visit: impl FnMut(CellIndex, Point, u32),
) {
    let Reach { around, radius_m, wedge } = reach;
    let (first, last) = corners(grid, around, radius_m);
    let half_diagonal_m = FRAC_1_SQRT_2 * TILE_SIDE as f64 * grid.cell_size_m();
    let mut before = 0_u32;
    for y in first.y..=last.y {
        for x in first.x..=last.x {
            let key = TileKey { x, y };
            let middle = grid.center(key.cell(TILE_CELLS / 2 + TILE_SIDE / 2));
            let hides = |offset: usize, side: usize| {
                let (low, side_m) = (grid.center(key.cell(offset)), side as f64 * grid.cell_size_m());
                let seen = |beside_m: f64| {
                    let beside_m = beside_m - 0.5 * grid.cell_size_m();
                    Point::new(low.x_m + beside_m - around.x_m, low.y_m + beside_m - around.y_m)
                };
                hides(seen(0.0), seen(side_m))
            };
            let tile = grid.tile(key).filter(|_| {
                !wedge.misses(middle, half_diagonal_m + grid.cell_size_m()) && !hides(0, TILE_SIDE)
            });
            if let Some(tile) = tile {
                visit_tile(
                    grid,
                    key,
                    tile,
                    |part| hides(part, PART),
                    |cell, center, place| {
                        let (dx, dy) = (center.x_m - around.x_m, center.y_m - around.y_m);
                        if dx * dx + dy * dy <= radius_m * radius_m && wedge.has(center) {
                            visit(cell, center, before.saturating_add(place));
                        }
                    },
                );
            }
            before = before.saturating_add(TILE_CELLS as u32);
        }
    }
}

/// Calls `visit` with the middle of each block of cells, of which one is occupied and within `radius_m` of a point, and with how far its
/// corners are from there.
pub(crate) fn for_each_occupied_block<H: Deref<Target = Tile>>(
    grid: &TileGrid<H>,
    around: Point,
    radius_m: f64,
    mut visit: impl FnMut(Point, f64),
) {
    let (first, last) = corners(grid, around, radius_m);
    let block_m = BLOCK as f64 * grid.cell_size_m();
    let half_diagonal_m = FRAC_1_SQRT_2 * block_m;
    for key in (first.y..=last.y).flat_map(|y| (first.x..=last.x).map(move |x| TileKey { x, y })) {
        let Some(tile) = grid.tile(key) else { continue };
        let corner = grid.center(key.cell(0));
        for (block, _) in tile.score_quarter.iter().enumerate().filter(|(_, score)| **score > OCCUPIED_SCORE)
        {
            // Half a cell and half a block from the middle of the first cell.
            let along = |blocks: usize| (blocks as f64 + 0.5) * block_m - 0.5 * grid.cell_size_m();
            let middle = Point::new(corner.x_m + along(block % BLOCKS), corner.y_m + along(block / BLOCKS));
            let (dx, dy) = (middle.x_m - around.x_m, middle.y_m - around.y_m);
            if dx * dx + dy * dy <= (radius_m + half_diagonal_m).powi(2) {
                visit(middle, half_diagonal_m);
            }
        }
    }
}

/// The tiles around everything within `radius_m` of a point.
fn corners<H: Deref<Target = Tile>>(grid: &TileGrid<H>, around: Point, radius_m: f64) -> (TileKey, TileKey) {
    let corner = |sign: f64| {
        grid.cell_at(Point::new(around.x_m + sign * radius_m, around.y_m + sign * radius_m)).tile()
    };
    (corner(-1.0), corner(1.0))
}

fn visit_tile<H: Deref<Target = Tile>>(
    grid: &TileGrid<H>,
    key: TileKey,
    tile: &Tile,
    hides: impl Fn(usize) -> bool,
    mut visit: impl FnMut(CellIndex, Point, u32),
) {
    let hidden: [bool; PARTS * PARTS] =
        std::array::from_fn(|part| hides((part / PARTS * TILE_SIDE + part % PARTS) * PART));
    for (block, _) in tile.score_quarter.iter().enumerate().filter(|(_, score)| **score > OCCUPIED_SCORE) {
        if hidden[block / BLOCKS / PART_BLOCKS * PARTS + block % BLOCKS / PART_BLOCKS] {
            continue;
        }
        let first = (block / BLOCKS) * BLOCK * TILE_SIDE + (block % BLOCKS) * BLOCK;
        for (row, column) in (0..BLOCK).flat_map(|row| (0..BLOCK).map(move |column| (row, column))) {
            let offset = first + row * TILE_SIDE + column;
            if tile.score[offset] > OCCUPIED_SCORE {
                let cell = key.cell(offset);
                visit(cell, grid.center(cell), ((block * BLOCK + row) * BLOCK + column) as u32);
            }
        }
    }
}

/// Whether a cell of a tile is occupied.
pub(crate) fn is_occupied(tile: &Tile, offset: usize) -> bool {
    tile.score[offset] > OCCUPIED_SCORE
}

/// Whether a cell or one of its eight neighbours is occupied.
pub(crate) fn occupied_around<H: Deref<Target = Tile>>(grid: &TileGrid<H>, cell: CellIndex) -> bool {
    let (column, row) = (cell.offset() % TILE_SIDE, cell.offset() / TILE_SIDE);
    let inner = 1..TILE_SIDE - 1;
    if inner.contains(&column) && inner.contains(&row) {
        return grid.tile(cell.tile()).is_some_and(|tile| {
            (row - 1..=row + 1).any(|row| {
                let first = row * TILE_SIDE + column - 1;
                tile.score[first..first + 3].iter().any(|score| *score > OCCUPIED_SCORE)
            })
        });
    }
    let occupied =
        |cell: CellIndex| grid.tile(cell.tile()).is_some_and(|tile| is_occupied(tile, cell.offset()));
    (-1..=1).any(|dy: i32| {
        (-1..=1).any(|dx: i32| occupied(CellIndex::new(cell.x.saturating_add(dx), cell.y.saturating_add(dy))))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sector::Sector;
    use flockslam_geometry::Pose;
    use proptest::prelude::*;
    use std::collections::{BTreeMap, BTreeSet};

    proptest! {
        #[test]
        fn exactly_the_occupied_cells_in_reach_are_visited(
            places in prop::collection::btree_set((-150_i32..150, -150_i32..150), 0..60),
            x in -3.0..3.0_f64, y in -3.0..3.0_f64, radius in 0.1..6.0_f64, turn in -3.0..3.0_f64,
        ) {
            let mut tiles: BTreeMap<TileKey, Box<Tile>> = BTreeMap::new();
            for (x, y) in &places {
                let cell = CellIndex::new(*x, *y);
                tiles.entry(cell.tile()).or_insert_with(|| Tile::unknown(0)).set_score(cell.offset(), 60_000);
            }
            let mut grid = TileGrid::new(0.05);
            for (key, tile) in tiles {
                grid.set(key, tile).unwrap();
            }
            let around = Point::new(x, y);
            let (mut found, mut at) = (BTreeSet::new(), BTreeMap::new());
            let mut last = None;
            let wedge = |sector: Sector| sector.wedge(Pose::new(x, y, turn));
            let whole = Reach { around, radius_m: radius, wedge: wedge(Sector::WHOLE) };
            for_each_occupied(&grid, whole, |_, _| false, |cell, _, place| {
                assert!(found.insert((cell.x, cell.y)) && last < Some(place));
                at.insert(place, cell);
                last = Some(place);
            });
            // In parts each is visited once, and has the same place.
            let mut in_parts = BTreeMap::new();
            for part in 0..3 {
                let reach = Reach { wedge: wedge(Sector::new(part, 3)), ..whole };
                for_each_occupied(&grid, reach, |_, _| false, |cell, _, place| assert!(in_parts.insert(place, cell).is_none()));
            }
            prop_assert_eq!(at, in_parts);
            let near = |(x, y): &(i32, i32)| grid.center(CellIndex::new(*x, *y)).distance_m(around) <= radius;
            prop_assert_eq!(found, places.into_iter().filter(near).collect::<BTreeSet<_>>());
        }
    }
}
