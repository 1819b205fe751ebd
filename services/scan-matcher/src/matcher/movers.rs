//! Beams on moving bodies are set aside before a scan is fitted.

use super::bodies::without_bodies;
use super::points::add_beams;
use super::{MoverMask, POINTS_MIN_FOR_SHARE, ScanMatcher, ScanPoints};
use crate::prediction::Prediction;
use flockslam_evidence::{CellIndex, PackedCell, TILE_SIDE, Tile, TileGrid, WEIGHT_SCALE};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::ScanView;
use flockslam_registration::cloud::Placement;
use std::ops::{Deref, Range};

/// A cell with this much evidence for "free", nat, was passed through by several scans.
const FREE_NAT: f64 = 1.5;
/// A score above the middle: the evidence for "occupied" outweighs that for "free".
const OCCUPIED_SCORE: u16 = u16::MAX / 2;
/// Grid cells along a side of the blocks whose greatest score a tile holds.
const BLOCK: i32 = 4;
/// A cell with this much evidence, nat, was hit by several scans: it is part of the map, not the trace of a person.
const ESTABLISHED_NAT: f64 = 4.0;
/// A beam may have met an occupied cell within this distance of its point, cells.
const NEAR_CELLS: i32 = 3;
/// Points of neighbouring beams nearer to each other than this belong together, metres.
const JOIN_M: f64 = 0.3;
/// A person is narrower than this, metres, …
const BODY_WIDTH_MAX_M: f64 = 0.6;
/// … shows at least so many points, and can be distinguished from clutter within this range, metres.
const BODY_POINTS_MIN: usize = 3;
const BODY_RANGE_MAX_M: f64 = 10.0;
/// A cluster wider than this, metres, is a wall or a row of furniture, which does not move …
const WIDE_M: f64 = 1.5;
/// … so a robot with more than this share of the scan's points on such clusters in free space is not at its predicted
/// pose.
const WIDE_MAX: f64 = 0.08;
/// A body may have this share of its points near something established.
const BODY_ESTABLISHED_MAX: f64 = 0.2;

impl ScanMatcher {
    /// Sets aside the beams on other robots and on what moves, then removes what is as narrow as a person: the points that are left, and
    /// the beams that are not matched. A robot that does not know its place takes walls for movers, and one that is lost needs all that
    /// it sees to tell one place from another.
    pub(super) fn mask_movers<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        points: ScanPoints,
        prediction: &Prediction,
        grid: &TileGrid<H>,
    ) -> (ScanPoints, MoverMask) {
        let (mut points, mut mask) = (points, std::mem::take(&mut self.buffers.mask));
        let share_max = self.settings.moving_share_max;
        if self.pose_is_certain(scan, prediction) && points.len() >= POINTS_MIN_FOR_SHARE {
            (points, mask) = self.without_flock_robots(scan, points, mask, prediction.pose);
            (points, mask) = without_movers(points, mask, prediction.pose, grid, share_max);
        }
        if share_max > 0.0 && self.confidence.lost == 0 {
            (points, mask) = without_bodies(points, mask);
        }
        (points, mask)
    }

    fn pose_is_certain(&self, scan: ScanView<'_>, prediction: &Prediction) -> bool {
        self.confidence.lost == 0
            && !self.confidence.slips
            && prediction.steady.is_none()
            && scan.odometry().is_some()
            && self.confidence.has_started()
    }
}

/// Sets aside the beams that, seen from `pose`, end in space known to be free with nothing near, unless there are suspiciously many.
fn without_movers<H: Deref<Target = Tile>>(
    points: ScanPoints,
    mut mask: MoverMask,
    pose: Pose,
    grid: &TileGrid<H>,
    share_max: f64,
) -> (ScanPoints, MoverMask) {
    let of_flock_robots = mask.moving.len();
    mask.unmark(points.len());
    let placement = Placement::from(pose);
    let (mut first, mut wide) = (0, 0);
    for end in 1..=points.len() {
        if points.ends.get(end).is_some_and(|next| next.distance_m(points.ends[end - 1]) < JOIN_M) {
            continue;
        }
        let aside = mark_piece(&points, first..end, &mut mask, of_flock_robots, &placement, grid);
        if points.ends[first].distance_m(points.ends[end - 1]) > WIDE_M {
            wide += aside;
        }
        mask.aside += aside;
        first = end;
    }
    let share = |count: usize| count as f64 / points.len() as f64;
    if share(mask.aside) > share_max || share(wide) > WIDE_MAX {
        mask.moving.truncate(of_flock_robots);
        mask.unmark(points.len());
        mask.aside = 0;
    }
    // Points on several robots are not in the order of their beams; no beam is published twice.
    mask.moving.sort_unstable_by_key(|range| range.first);
    (points.without(&mask.marks), mask)
}

/// Marks those of a piece of points beside each other that lie on what moves; gives how many. Their beams are published after the first
/// `of_flock_robots` ranges.
fn mark_piece<H: Deref<Target = Tile>>(
    points: &ScanPoints,
    piece: Range<usize>,
    mask: &mut MoverMask,
    of_flock_robots: usize,
    pose: &Placement,
    grid: &TileGrid<H>,
) -> usize {
    let body = is_new_body(grid, pose, &points.ends[piece.clone()]);
    let mut marked = 0;
    for i in piece {
        if body || ends_where_nothing_stood(grid, in_odom(pose, points.ends[i])) {
            marked += 1;
            mask.marks[i] = true;
            add_beams(&mut mask.moving, of_flock_robots, points.beams[i], points.stride);
        }
    }
    marked
}

/// Whether points beside each other, in the robot's frame, are as wide as a person who stands free, where nothing is established.
fn is_new_body<H: Deref<Target = Tile>>(grid: &TileGrid<H>, pose: &Placement, points: &[Point]) -> bool {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return false };
    if points.len() < BODY_POINTS_MIN
        || first.distance_m(*last) > BODY_WIDTH_MAX_M
        || first.norm_m() > BODY_RANGE_MAX_M
    {
        return false;
    }
    let is_established = |point: &&Point| something_stands_near(grid, grid.cell_at(in_odom(pose, **point)));
    let established = points.iter().filter(is_established).count();
    established as f64 <= BODY_ESTABLISHED_MAX * points.len() as f64
}

fn in_odom(pose: &Placement, point: Point) -> Point {
    let (x_m, y_m) = pose.apply(point.x_m, point.y_m);
    Point::new(x_m, y_m)
}

/// Whether a point is in space that is known to be free, with nothing established near it.
fn ends_where_nothing_stood<H: Deref<Target = Tile>>(grid: &TileGrid<H>, point: Point) -> bool {
    let cell = grid.cell_at(point);
    let is_free = f64::from(grid.cell(cell).free) >= FREE_NAT * WEIGHT_SCALE;
    is_free && !something_stands_near(grid, cell)
}

fn something_stands_near<H: Deref<Target = Tile>>(grid: &TileGrid<H>, cell: CellIndex) -> bool {
    // Most points lie on what stands.
    if is_established(grid.cell(cell)) {
        return true;
    }
    let blocks = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
    if blocks.into_iter().all(|(dx, dy)| is_empty_block(grid, cell, dx, dy)) {
        return false;
    }
    let around = -NEAR_CELLS..=NEAR_CELLS;
    around.clone().any(|dy| {
        around.clone().any(|dx| {
            is_established(grid.cell(CellIndex::new(cell.x.saturating_add(dx), cell.y.saturating_add(dy))))
        })
    })
}

fn is_established(evidence: PackedCell) -> bool {
    evidence.occupied >= (ESTABLISHED_NAT * WEIGHT_SCALE) as u16 && evidence.occupied > evidence.free
}

fn is_empty_block<H: Deref<Target = Tile>>(grid: &TileGrid<H>, around: CellIndex, dx: i32, dy: i32) -> bool {
    let cell = CellIndex::new(around.x.saturating_add(dx * BLOCK), around.y.saturating_add(dy * BLOCK));
    grid.tile(cell.tile()).is_none_or(|tile| {
        let (column, row) = (cell.offset() % TILE_SIDE, cell.offset() / TILE_SIDE);
        let block = BLOCK as usize;
        tile.score_quarter[(row / block) * (TILE_SIDE / block) + column / block] <= OCCUPIED_SCORE
    })
}
