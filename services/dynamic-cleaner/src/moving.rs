use crate::cells::occupied_around;
use flockslam_evidence::{Tile, TileGrid, WEIGHT_SCALE};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{Deskew, ScanView};
use std::ops::{Deref, Range};

/// A cell with this much evidence for "free" (nat) was looked through by several scans.
const FREE_NAT: f64 = 1.5;

/// Number of these beams, within `radius_m` that end where the grid knows free space and nothing near: they lie on something
/// that was not there before.
pub(crate) fn moving_beams<H: Deref<Target = Tile>>(
    scan: ScanView<'_>,
    beams: Range<usize>,
    deskew: &Deskew,
    odom_from_laser: Pose,
    grid: &TileGrid<H>,
    radius_m: f64,
) -> u32 {
    let free = (FREE_NAT * WEIGHT_SCALE) as u16;
    let ends_in_free_space = |beam: &usize| {
        let (angle_rad, range_m) = deskew.beam_at_stamp(scan, *beam);
        let Some(range_m) = range_m.filter(|range| *range <= radius_m) else { return false };
        let (sin, cos) = (odom_from_laser.heading_rad + angle_rad).sin_cos();
        let end = Point::new(odom_from_laser.x_m + range_m * cos, odom_from_laser.y_m + range_m * sin);
        let cell = grid.cell_at(end);
        grid.cell(cell).free >= free && !occupied_around(grid, cell)
    };
    beams.filter(ends_in_free_space).count() as u32
}
