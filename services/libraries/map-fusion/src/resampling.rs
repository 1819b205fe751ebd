//! Nearest-cell resampling: from a submap and its pose to the cells of the fused map that its evidence falls into.

use flockslam_evidence::{CellIndex, PackedCell, Submap, SubmapTile, TILE_CELLS, TILE_SIDE, TileKey, floor};
use flockslam_geometry::elementary::sin_cos;
use flockslam_geometry::{Point, Pose};

/// Binary digits behind the point of fixed-point cell coordinates.
const FRACTION: u32 = 32;
const SIDE: i32 = TILE_SIDE as i32;

/// The block of 8 × 8 cells that a cell of a tile is in, row by row.
#[inline]
fn block(cell: usize) -> usize {
    cell >> 9 << 3 | cell >> 3 & 7
}

/// Maps cells of the fused map to cells of a submap, by the centre of the former.
///
/// A linear function in whole numbers: what it gives for a cell does not depend on where the walk over the cells began, so each
/// target cell has exactly one source cell, in whichever tile, and there are no holes whatever the rotation.
#[derive(Debug)]
pub struct Resampling {
    map_from_odom: Pose,
    source_size_m: f64,
    target_size_m: f64,
    /// Target cell that the coordinates below are relative to.
    origin: CellIndex,
    /// Source coordinates of its centre.
    start: (i64, i64),
    /// Source coordinates gained by a step along x; a step along y gains (-second, first).
    step: (i64, i64),
}

/// Evidence that falls into one tile of the fused map.
pub struct Resampled<'a> {
    /// The tile of the fused map.
    pub key: TileKey,
    /// Places in it, in ascending order, and the evidence for each, never unknown.
    pub cells: &'a [(u16, PackedCell)],
    /// Blocks of 8 × 8 cells with evidence of the submap (bit = row of blocks · 8 + column), whether cleared or not.
    pub blocks: u64,
}

impl Resampling {
    /// For a submap with its reference pose at `map_from_submap`.
    pub fn new(submap: &Submap, map_from_submap: Pose, target_size_m: f64) -> Self {
        Self::of_lattice(submap.odom_from_submap, submap.cell_size_m, map_from_submap, target_size_m)
    }

    /// For a submap of cells of this side, metres, with its reference pose in odom and in the map.
    pub(crate) fn of_lattice(
        odom_from_submap: Pose,
        source_size_m: f64,
        map_from_submap: Pose,
        target_size_m: f64,
    ) -> Self {
        let map_from_odom = map_from_submap * odom_from_submap.inverse();
        let odom_from_map = map_from_odom.inverse();
        let origin = CellIndex::new(
            floor(map_from_submap.x_m / target_size_m),
            floor(map_from_submap.y_m / target_size_m),
        );
        let centre = |cell: i32| (f64::from(cell) + 0.5) * target_size_m;
        let at = odom_from_map.apply(Point::new(centre(origin.x), centre(origin.y)));
        // A float cast saturates: absurd poses give some cell, and are refused as too far from the others.
        let fixed = |cells: f64| (cells * (1u64 << FRACTION) as f64).round() as i64;
        let (sin, cos) = sin_cos(odom_from_map.heading_rad);
        let ratio = target_size_m / source_size_m;
        Self {
            map_from_odom,
            source_size_m,
            target_size_m,
            origin,
            start: (fixed(at.x_m / source_size_m), fixed(at.y_m / source_size_m)),
            step: (fixed(cos * ratio), fixed(sin * ratio)),
        }
    }

    /// Calls `visit` for each tile of the fused map that evidence of `tile` falls into.
    pub fn for_each(&self, tile: &SubmapTile, mut visit: impl FnMut(Resampled<'_>)) {
        let (low, high) = self.target_bounds(tile.key);
        let mut cells = Vec::with_capacity(TILE_CELLS);
        for y in low.tile().y..=high.tile().y {
            for x in low.tile().x..=high.tile().x {
                let key = TileKey { x, y };
                cells.clear();
                let blocks = self.gather(tile, key, (low, high), &mut cells);
                if blocks != 0 {
                    visit(Resampled { key, cells: &cells, blocks });
                }
            }
        }
    }

    fn gather(
        &self,
        tile: &SubmapTile,
        key: TileKey,
        bounds: (CellIndex, CellIndex),
        cells: &mut Vec<(u16, PackedCell)>,
    ) -> u64 {
        let mut blocks = 0;
        self.walk(tile.key, key, bounds, |target, source| {
            let evidence = tile.cells[source];
            if evidence.is_unknown() {
                return;
            }
            blocks |= 1 << block(target);
            if !tile.is_cleared(source) {
                cells.push((target as u16, evidence));
            }
        });
        blocks
    }

    /// Calls `visit` with the places of the cells of tile `key` of the fused map, in ascending order, and of the cells of a source tile
    /// that they take their evidence from.
    #[inline]
    fn walk(
        &self,
        tile: TileKey,
        key: TileKey,
        (low, high): (CellIndex, CellIndex),
        mut visit: impl FnMut(usize, usize),
    ) {
        let corner = key.cell(0);
        let within = |low: i32, high: i32, corner: i32| {
            let last = i64::from(high) - i64::from(corner);
            (low.saturating_sub(corner).max(0), last.min(i64::from(SIDE) - 1) as i32)
        };
        let (x0, x1) = within(low.x, high.x, corner.x);
        let (y0, y1) = within(low.y, high.y, corner.y);
        let (left, bottom) = (i64::from(tile.x) * i64::from(SIDE), i64::from(tile.y) * i64::from(SIDE));
        for y in y0..=y1 {
            let (mut u, mut v) =
                self.source(i64::from(corner.x) + i64::from(x0), i64::from(corner.y) + i64::from(y));
            for x in x0..=x1 {
                let (column, row) = ((u >> FRACTION) - left, (v >> FRACTION) - bottom);
                (u, v) = (u.wrapping_add(self.step.0), v.wrapping_add(self.step.1));
                // Both are within 0 … 63 exactly when no higher bit is set in either.
                if (column | row) as u64 >= TILE_SIDE as u64 {
                    continue;
                }
                visit((y << 6 | x) as usize, (row << 6 | column) as usize);
            }
        }
    }

    /// The cell of the submap's lattice whose evidence falls into a target cell; `None` when that is absurdly far away.
    pub fn source_cell(&self, target: CellIndex) -> Option<CellIndex> {
        let (u, v) = self.source(i64::from(target.x), i64::from(target.y));
        let index = |fixed: i64| i32::try_from(fixed >> FRACTION).ok();
        Some(CellIndex::new(index(u)?, index(v)?))
    }

    /// The target cells that take their evidence from a cell of the submap's lattice.
    pub fn targets(&self, source: CellIndex) -> impl Iterator<Item = CellIndex> {
        // The centre of such a cell is within half a diagonal of the source's centre.
        let reach = 1 + floor(std::f64::consts::FRAC_1_SQRT_2 * self.source_size_m / self.target_size_m);
        let centre = |cell: i32| (f64::from(cell) + 0.5) * self.source_size_m;
        let at = self.map_from_odom.apply(Point::new(centre(source.x), centre(source.y)));
        let (x, y) = (floor(at.x_m / self.target_size_m), floor(at.y_m / self.target_size_m));
        let around = (-reach..=reach).flat_map(move |dy| {
            (-reach..=reach).map(move |dx| CellIndex::new(x.saturating_add(dx), y.saturating_add(dy)))
        });
        around.filter(move |target| self.source_cell(*target) == Some(source))
    }

    /// Fixed-point source coordinates of a target cell's centre.
    fn source(&self, x: i64, y: i64) -> (i64, i64) {
        let (dx, dy) = (x - i64::from(self.origin.x), y - i64::from(self.origin.y));
        let along = |by: i64, step: i64| by.wrapping_mul(step);
        (
            self.start.0.wrapping_add(along(dx, self.step.0)).wrapping_sub(along(dy, self.step.1)),
            self.start.1.wrapping_add(along(dx, self.step.1)).wrapping_add(along(dy, self.step.0)),
        )
    }

    /// Target cells that a source tile can touch.
    fn target_bounds(&self, key: TileKey) -> (CellIndex, CellIndex) {
        let side_m = self.source_size_m * TILE_SIDE as f64;
        let (x, y) = (f64::from(key.x) * side_m, f64::from(key.y) * side_m);
        let corners = [(x, y), (x + side_m, y), (x, y + side_m), (x + side_m, y + side_m)]
            .map(|(x, y)| self.map_from_odom.apply(Point::new(x, y)));
        let cell = |m: f64, margin: i32| floor(m / self.target_size_m).saturating_add(margin);
        let least = |f: fn(&Point) -> f64| corners.iter().map(f).fold(f64::INFINITY, f64::min);
        let most = |f: fn(&Point) -> f64| corners.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
        (
            CellIndex::new(cell(least(|p| p.x_m), -1), cell(least(|p| p.y_m), -1)),
            CellIndex::new(cell(most(|p| p.x_m), 1), cell(most(|p| p.y_m), 1)),
        )
    }
}
