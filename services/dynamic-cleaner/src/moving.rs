//! Finds the beams of a scan that end in known free space: they lie on moving bodies. The tracker takes their end points.

use crate::cells::{is_occupied, occupied_around};
use flockslam_evidence::{Tile, TileGrid, WEIGHT_SCALE};
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{Deskew, ScanView};
use std::ops::Deref;

/// A cell with this much evidence for "free" (nat) was looked through by several scans.
const FREE_NAT: f64 = 1.5;

/// Fills `ends` with the ends (in odom) of the beams within `radius_m` that end where the grid knows free space and nothing
/// near: they lie on objects that were not there before.
pub(crate) fn find_moving<H: Deref<Target = Tile>>(
    scan: ScanView<'_>,
    deskew: &Deskew,
    odom_from_laser: Pose,
    grid: &TileGrid<H>,
    radius_m: f64,
    ends: &mut Vec<Point>,
) {
    ends.clear();
    let free = (FREE_NAT * WEIGHT_SCALE) as u16;
    for beam in 0..scan.len() {
        let (angle_rad, range_m) = deskew.beam_at_stamp(scan, beam);
        let Some(range_m) = range_m.filter(|range| *range <= radius_m) else { continue };
        let (sin, cos) = sin_cos(odom_from_laser.heading_rad + angle_rad);
        let end = Point::new(odom_from_laser.x_m + range_m * cos, odom_from_laser.y_m + range_m * sin);
        let cell = grid.cell_at(end);
        // Most beams end on static objects or in unknown space.
        let is_candidate =
            |tile: &&Tile| tile.cells[cell.offset()].free >= free && !is_occupied(tile, cell.offset());
        if grid.tile(cell.tile()).filter(is_candidate).is_some() && !occupied_around(grid, cell) {
            ends.push(end);
        }
    }
}
