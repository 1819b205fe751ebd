//! Two robots see the same wall from both sides. Each submap is filled by beams through the sensor model and placed at its pose;
//! the fused map is the sum of both. The order of fusing does not matter, and a submap can be taken out again.
//!
//! `cargo run -p flockslam-evidence --example fuse_maps`

use flockslam_evidence::{Cell, CellIndex, Masses, PackedCell, Submap, SubmapTile, TILE_CELLS};
use flockslam_geometry::{Point, Pose};
use flockslam_map_fusion::FusedMap;
use flockslam_ray_insertion::{ObservedCells, SensorModel};
use std::collections::BTreeMap;
use std::f64::consts::PI;

const CELL_SIZE_M: f64 = 0.1;

/// The evidence of one scan: of several observations of a cell the first counts.
#[derive(Default)]
struct Scan(BTreeMap<CellIndex, Cell>);

impl ObservedCells for Scan {
    fn observe(&mut self, cell: CellIndex, evidence: Cell) {
        self.0.entry(cell).or_insert(evidence);
    }
}

/// A submap of a robot that stands still, 2 m in front of a wall across its way, for so many scans.
fn submap_of_a_wall(number: u32, scans: u32) -> Submap {
    let hit = Cell::from_masses(Masses::observation(0.9, 0.3));
    let miss = Cell::from_masses(Masses::observation(0.1, 0.1));
    let model = SensorModel::new(hit, miss);
    let (origin, wall) = (Point::new(0.05, 0.05), -10..=10);
    let ends: Vec<Point> = wall.map(|i| Point::new(2.05, 0.05 + 0.1 * f64::from(i))).collect();
    let mut sums: BTreeMap<CellIndex, Cell> = BTreeMap::new();
    for _ in 0..scans {
        let mut scan = Scan::default();
        model.insert(CELL_SIZE_M, origin, &ends, &mut scan);
        for (cell, evidence) in scan.0 {
            let sum = sums.entry(cell).or_default();
            *sum = sum.combine(evidence);
        }
    }
    let mut tiles = BTreeMap::new();
    for (cell, sum) in sums {
        let empty = || SubmapTile::new(cell.tile(), Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
        let tile = tiles.entry(cell.tile()).or_insert_with(empty);
        tile.cells[cell.offset()] = sum.pack();
    }
    Submap {
        number,
        trajectory: 0,
        insertions: scans,
        first: 0,
        last: u64::from(scans) - 1,
        odom_from_submap: Pose::IDENTITY,
        cell_size_m: CELL_SIZE_M,
        tiles: tiles.into_values().collect(),
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (first, second) = (submap_of_a_wall(0, 5), submap_of_a_wall(1, 3));
    // The second robot stands on the other side of the wall and faces back.
    let (map_from_first, map_from_second) = (Pose::IDENTITY, Pose::new(4.1, 0.1, PI));
    let mut map = FusedMap::new(CELL_SIZE_M);
    map.add(&first, map_from_first)?;
    map.add(&second, map_from_second)?;
    for x in [-5, 10, 20, 30, 45] {
        let cell = map.cell(CellIndex::new(x, 0));
        let ((for_it, against_it), probability) = (cell.weights_nat(), cell.masses().pignistic());
        println!("({x:2}, 0): for occupied {for_it:.2} nat, against {against_it:.2}: {probability:.2}");
    }

    // Both have seen the wall; each has seen its own side of it.
    let wall = CellIndex::new(20, 0);
    assert_eq!(map.cell(wall), first.cell(wall).unpack().combine(second.cell(wall).unpack()));
    assert_eq!(map.cell(CellIndex::new(10, 0)), first.cell(CellIndex::new(10, 0)).unpack());
    assert_eq!(map.cell(CellIndex::new(30, 0)), second.cell(CellIndex::new(10, 0)).unpack());
    assert!(map.cell(wall).masses().occupancy() > Some(0.5));
    assert!(map.cell(CellIndex::new(45, 0)).is_unknown());

    let mut other_order = FusedMap::new(CELL_SIZE_M);
    other_order.add(&second, map_from_second)?;
    other_order.add(&first, map_from_first)?;
    assert!(map == other_order, "fusing is commutative");

    map.withdraw(&first, map_from_first)?;
    let mut second_alone = FusedMap::new(CELL_SIZE_M);
    second_alone.add(&second, map_from_second)?;
    assert!(map == second_alone, "what was taken out has left no trace");
    Ok(())
}
