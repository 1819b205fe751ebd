//! Finds the cells of a closed submap that newer ones have found free: the world has changed since.

use crate::FusedMap;
use flockslam_evidence::{Cell, CellIndex, Submap, WEIGHT_SCALE, floor};
use flockslam_geometry::{Point, Pose};

/// Newer evidence for "free" that a stale cell and its neighbours have, nat: three scans have looked through them.
const FREE_NAT: f64 = 0.9;
/// Within this distance of a stale cell newer submaps have not met anything, cells: poses and ranges have errors.
const APART_CELLS: i32 = 2;
/// Newer submaps that contradict more than this share of the occupied cells that they can classify lie in another place: then nothing
/// is stale.
const CONTRADICTED_MAX: f64 = 0.2;

/// Classification of an occupied cell by newer submaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Contradiction {
    /// It is free, and everything around it.
    Gone,
    /// Something stands there.
    Stands,
    /// Neither.
    Open,
}

/// The cells of a submap with evidence for "occupied" that newer submaps have found free; `newer` is their sum, in the map.
pub fn stale_cells(submap: &Submap, map_from_odom: Pose, newer: &FusedMap) -> Vec<CellIndex> {
    let (mut stale, mut standing) = (Vec::new(), 0);
    for tile in &submap.tiles {
        let occupied = tile
            .cells
            .iter()
            .enumerate()
            .filter(|(offset, cell)| cell.occupied > 0 && !tile.is_cleared(*offset));
        for (offset, cell) in occupied {
            let index = tile.key.cell(offset);
            match classify(newer, map_from_odom.apply(center(submap, index))) {
                Contradiction::Gone => stale.push(index),
                Contradiction::Stands if cell.occupied > cell.free => standing += 1,
                Contradiction::Stands | Contradiction::Open => (),
            }
        }
    }
    let classified = (stale.len() + standing) as f64;
    if stale.len() as f64 > CONTRADICTED_MAX * classified {
        stale.clear();
    }
    stale
}

fn classify(newer: &FusedMap, at: Point) -> Contradiction {
    let index = |metres: f64| floor(metres / newer.cell_size_m());
    let (x, y) = (index(at.x_m), index(at.y_m));
    let around = |reach: i32| {
        (-reach..=reach).flat_map(move |dy| {
            (-reach..=reach).map(move |dx| CellIndex::new(x.saturating_add(dx), y.saturating_add(dy)))
        })
    };
    let is_free = |cell: Cell| f64::from(cell.free) >= FREE_NAT * WEIGHT_SCALE;
    if !is_free(newer.cell(CellIndex::new(x, y))) {
        let stands = around(APART_CELLS).map(|cell| newer.cell(cell)).any(|cell| cell.occupied > cell.free);
        return if stands { Contradiction::Stands } else { Contradiction::Open };
    }
    let near = around(APART_CELLS).map(|cell| newer.cell(cell));
    match near.fold((false, false), |(met, stands), cell| {
        (met || cell.occupied > 0, stands || cell.occupied > cell.free)
    }) {
        (_, true) => Contradiction::Stands,
        (true, false) => Contradiction::Open,
        (false, false) if around(1).all(|cell| is_free(newer.cell(cell))) => Contradiction::Gone,
        (false, false) => Contradiction::Open,
    }
}

fn center(submap: &Submap, cell: CellIndex) -> Point {
    let middle = |index: i32| (f64::from(index) + 0.5) * submap.cell_size_m;
    Point::new(middle(cell.x), middle(cell.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{PackedCell, SubmapTile, TILE_CELLS, TILE_SIDE, TileKey};

    const CELL_M: f64 = 0.05;

    /// A room with walls around, and things in it: a column and a row of cells each.
    fn room(number: u32, things: &[(usize, usize)]) -> Submap {
        let cell = |offset: usize| {
            let (x, y) = (offset % TILE_SIDE, offset / TILE_SIDE);
            let is_wall = [x, y].iter().any(|place| [4, 59].contains(place));
            match (things.contains(&(x, y)) || is_wall, (4..60).contains(&x) && (4..60).contains(&y)) {
                (true, true) => PackedCell { occupied: 9000, free: 100 },
                (false, true) => PackedCell { occupied: 0, free: 5000 },
                _ => PackedCell::UNKNOWN,
            }
        };
        let cells = Box::new(std::array::from_fn::<_, TILE_CELLS, _>(cell));
        Submap {
            number,
            trajectory: 0,
            insertions: 9,
            first: 0,
            last: 1,
            odom_from_submap: Pose::new(1.0, 1.0, 0.5),
            cell_size_m: CELL_M,
            tiles: vec![SubmapTile::new(TileKey { x: 0, y: 0 }, cells)],
        }
    }

    fn sum(submaps: &[Submap], map_from_odom: Pose) -> FusedMap {
        let mut map = FusedMap::new(CELL_M);
        for submap in submaps {
            map.add(submap, map_from_odom * submap.odom_from_submap).unwrap();
        }
        map
    }

    #[test]
    fn what_newer_submaps_find_free_is_stale_and_walls_stay() {
        let (gone, stays) = ([(20, 20), (21, 20)], (40, 40));
        let old = room(0, &[gone[0], gone[1], stays]);
        let at = Pose::new(3.0, -1.0, 0.0);
        let stale = stale_cells(&old, at, &sum(&[room(1, &[stays])], at));
        let cells: Vec<_> = stale.iter().map(|cell| (cell.x as usize, cell.y as usize)).collect();
        assert_eq!(cells, gone);
        // Nothing is cleared beside an occupied cell: it may be the same object.
        assert!(stale_cells(&old, at, &sum(&[room(1, &[stays, (22, 20)])], at)).is_empty());
        // Seen in another place, walls are contradicted.
        let elsewhere = at * Pose::new(0.4, 0.4, 0.0);
        assert!(stale_cells(&old, at, &sum(&[room(1, &[])], elsewhere)).is_empty());
    }
}
