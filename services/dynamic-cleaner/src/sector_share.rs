//! Where the circle around the lidar is cut, so that the replicas get about equal numbers of occupied cells to classify.

use crate::cells::for_each_occupied_block;
use crate::sector::TURNS;
use flockslam_evidence::{Tile, TileGrid};
use flockslam_geometry::Pose;
use flockslam_geometry::elementary::sin_cos;
use std::ops::Deref;

/// Directions that occupied blocks are counted in, at most.
const BINS_MAX: usize = 256;

/// How the work of classifying the cells around a lidar is shared. It decides about nothing but time; equal grids give equal shares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SectorShare {
    /// Where the circle begins, in [`TURNS`]-ths of a sector, so that the sector with the most occupied cells has as few as possible: how
    /// long the slowest replica takes is how long all of them take. Cells are counted by blocks, angles measured roughly.
    pub turned: u32,
    /// No occupied cell is nearer than this, metres.
    pub nearest_m: f64,
}

impl SectorShare {
    /// For `parts` equal sectors of the circle around a lidar that reaches `radius_m`.
    pub fn new<H: Deref<Target = Tile>>(grid: &TileGrid<H>, laser: Pose, radius_m: f64, parts: u32) -> Self {
        let bins = (parts * TURNS) as usize;
        if parts == 1 || bins > BINS_MAX {
            return Self { turned: 0, nearest_m: 0.0 };
        }
        let (mut counts, mut nearest_m) = ([0_u32; BINS_MAX], radius_m);
        let (sin, cos) = sin_cos(laser.heading_rad);
        for_each_occupied_block(grid, laser.position(), radius_m, |middle, half_diagonal_m| {
            let (dx, dy) = (middle.x_m - laser.x_m, middle.y_m - laser.y_m);
            nearest_m = nearest_m.min((dx * dx + dy * dy).sqrt() - half_diagonal_m);
            let share = 0.25 * quarters(cos * dx + sin * dy, cos * dy - sin * dx);
            counts[((share * bins as f64) as usize).min(bins - 1)] += 1;
        });
        let fullest = |turned: u32| {
            let of = |part: u32| {
                let first = (part * TURNS + turned) as usize;
                (first..first + TURNS as usize).map(|bin| counts[bin % bins]).sum::<u32>()
            };
            (0..parts).map(of).max()
        };
        Self { turned: (0..TURNS).min_by_key(|turned| fullest(*turned)).unwrap_or(0), nearest_m }
    }
}

/// About the direction of (x, y) in quarters of a turn, 0 … 4: exact at the axes and half way between them.
fn quarters(x: f64, y: f64) -> f64 {
    let sum = x.abs() + y.abs();
    if sum == 0.0 {
        return 0.0;
    }
    if y >= 0.0 { 1.0 - x / sum } else { 3.0 + x / sum }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{CellIndex, TileKey};
    use std::collections::BTreeMap;
    use std::f64::consts::TAU;

    #[test]
    fn directions_are_exact_at_eighths_and_in_order() {
        let at = |share: f64| quarters((TAU * share).cos(), (TAU * share).sin());
        for eighth in 0..8 {
            let share = f64::from(eighth) / 8.0;
            assert!((at(share + 1e-12) - 4.0 * share).abs() < 1e-9, "{eighth}");
        }
        let all: Vec<f64> = (0..100).map(|step| at(f64::from(step) / 100.0)).collect();
        assert!(all.is_sorted());
    }

    /// Everything that stands is to one side of the lidar's axis: the border goes through the middle of it.
    #[test]
    fn a_border_goes_through_the_middle_of_what_stands() {
        let mut tiles: BTreeMap<TileKey, Box<Tile>> = BTreeMap::new();
        for (x, y) in (-60..60).flat_map(|x| (10..60).map(move |y| (x, y))) {
            let cell = CellIndex::new(x, y);
            tiles.entry(cell.tile()).or_insert_with(|| Tile::unknown(0)).set_score(cell.offset(), 60_000);
        }
        let mut grid = TileGrid::new(0.05);
        for (key, tile) in tiles {
            grid.set(key, tile).unwrap();
        }
        let share = |heading_rad: f64| SectorShare::new(&grid, Pose::new(0.0, 0.0, heading_rad), 12.0, 2);
        assert_eq!(share(0.0).turned, TURNS / 2);
        assert_eq!(share(TAU / 8.0).turned, TURNS / 4);
        assert_eq!(share(TAU / 4.0).turned, 0);
        // The lowest row of cells that stand is the eleventh; they are looked at in blocks of four.
        let nearest_m = share(0.0).nearest_m;
        assert!((0.3..0.525).contains(&nearest_m), "{nearest_m}");
    }
}
