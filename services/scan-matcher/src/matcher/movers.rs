//! Beams that lie on what moves are set aside before a scan is fitted.

use super::{ScanMatcher, TELLING_POINTS};
use crate::motion::Prediction;
use flockslam_evidence::{CellIndex, PackedCell, TILE_SIDE, Tile, TileGrid, WEIGHT_SCALE};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{BeamRange, ScanView};
use std::ops::Deref;

/// A cell with this much evidence for "free", nat, was looked through by several scans.
const FREE_NAT: f64 = 1.5;
/// A score above the middle: the evidence for "occupied" outweighs that for "free".
const OCCUPIED_SCORE: u16 = u16::MAX / 2;
/// Grid cells along a side of the blocks whose greatest score a tile holds.
const BLOCK: i32 = 4;
/// What has this much evidence, nat, was hit by several scans: it is part of the map, not the trace of who walks by.
const ESTABLISHED_NAT: f64 = 4.0;
/// What stands within this distance of a point, cells, may be what the beam met.
const NEAR_CELLS: i32 = 3;
/// Points of neighbouring beams nearer to each other than this belong together, metres.
const JOIN_M: f64 = 0.3;
/// Somebody is narrower than this, metres, …
const BODY_WIDTH_MAX_M: f64 = 0.6;
/// … shows at least so many points, and is told from clutter within this range, metres.
const BODY_POINTS_MIN: usize = 3;
const BODY_RANGE_MAX_M: f64 = 10.0;
/// What is wider than this, metres, is a wall or a row of furniture: nobody moves that …
const WIDE_M: f64 = 1.5;
/// … so a robot whose scan has more than this share of its points on such things where the grid is free is not where it believes
/// to be.
const WIDE_MAX: f64 = 0.08;
/// A body may have this share of its points near something established.
const BODY_ESTABLISHED_MAX: f64 = 0.2;

impl ScanMatcher {
    /// The beams of the last scan that were not matched since they lie on what moves, in order.
    pub fn moving_beams(&self) -> &[BeamRange] {
        &self.moving
    }

    /// Sets aside the beams that, where the robot should be, end in space known to be free with nothing near. A robot that does
    /// not know its place takes walls for movers: then, and when there are suspiciously many, nothing is set aside.
    pub(super) fn set_movers_aside<H: Deref<Target = Tile>>(
        &mut self,
        scan: ScanView<'_>,
        prediction: &Prediction,
        grid: &TileGrid<H>,
    ) {
        let knows_its_place = self.lost == 0
            && !self.slips
            && prediction.steady.is_none()
            && scan.odometry().is_some()
            && self.matched >= super::START_SCANS;
        if !knows_its_place || self.points.len() < TELLING_POINTS {
            return;
        }
        self.set_companions_aside(scan, prediction);
        let companions = self.moving.len();
        let stride = self.stride(scan) as u32;
        self.set_aside.clear();
        self.set_aside.resize(self.points.len(), false);
        let (mut first, mut wide) = (0, 0);
        for end in 1..=self.points.len() {
            let joined =
                self.points.get(end).is_some_and(|next| next.distance_m(self.points[end - 1]) < JOIN_M);
            if joined {
                continue;
            }
            let body = is_new_body(grid, prediction.pose, &self.points[first..end]);
            let before = self.aside;
            for i in first..end {
                if body || ends_where_nothing_stood(grid, prediction.pose.apply(self.points[i])) {
                    self.aside += 1;
                    self.set_aside[i] = true;
                    add_beams(&mut self.moving, companions, self.beams[i], stride);
                }
            }
            if self.points[first].distance_m(self.points[end - 1]) > WIDE_M {
                wide += self.aside - before;
            }
            first = end;
        }
        let share = |count: usize| count as f64 / self.points.len() as f64;
        if share(self.aside) > self.settings.moving_share_max || share(wide) > WIDE_MAX {
            self.moving.truncate(companions);
            self.aside = 0;
        } else if self.aside > 0 {
            self.leave_out_what_is_aside();
        }
        // Several companions are not in the order of their beams; no beam is told twice.
        self.moving.sort_unstable_by_key(|range| range.first);
    }

    pub(super) fn leave_out_what_is_aside(&mut self) {
        let mut kept = 0;
        for i in (0..self.points.len()).filter(|i| !self.set_aside[*i]) {
            self.points[kept] = self.points[i];
            self.beams[kept] = self.beams[i];
            self.times_s[kept] = self.times_s[i];
            kept += 1;
        }
        self.points.truncate(kept);
        self.beams.truncate(kept);
        self.times_s.truncate(kept);
    }
}

/// Adds beams to the ranges behind the first `apart`, which stay as they are: what was added can be taken back by cutting it off.
pub(super) fn add_beams(ranges: &mut Vec<BeamRange>, apart: usize, first: u32, count: u32) {
    match ranges[apart..].last_mut().filter(|range| range.end == first) {
        Some(range) => range.end += count,
        None => ranges.push(BeamRange { first, end: first + count }),
    }
}

/// Whether points beside each other, in the robot's frame, are as wide as somebody who stands free, where nothing is established.
fn is_new_body<H: Deref<Target = Tile>>(grid: &TileGrid<H>, pose: Pose, points: &[Point]) -> bool {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return false };
    if points.len() < BODY_POINTS_MIN
        || first.distance_m(*last) > BODY_WIDTH_MAX_M
        || first.norm_m() > BODY_RANGE_MAX_M
    {
        return false;
    }
    let is_established = |point: &&Point| something_stands_near(grid, grid.cell_at(pose.apply(**point)));
    let established = points.iter().filter(is_established).count();
    established as f64 <= BODY_ESTABLISHED_MAX * points.len() as f64
}

/// Whether a point lies in space that is known to be free, with nothing established near it.
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
