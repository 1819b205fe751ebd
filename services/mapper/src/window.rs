//! The grid around the robot that scans are matched to: evidence goes in, changed and retired tiles come out.

use crate::closed_submap::{ClosedSubmap, ClosedTile};
use crate::score::Scores;
use crate::settings::Settings;
use crate::tile_share::TileShare;
use crate::window_tile::WindowTile;
use flockslam_evidence::{
    Cell, CellIndex, PackedCell, SubmapTile, Tile, TileDirectory, TileKey, WEIGHT_SCALE,
};
use flockslam_ray_insertion::{CrossedCells, ObservedCells, Ray};

/// A cell with this much evidence for "free", nat, was passed through by several scans.
const CLEAR_NAT: f64 = 1.5;
/// A cell with this much evidence for "occupied", nat, and more than for "free", was hit by several scans: an object stands there.
const ESTABLISHED_NAT: f64 = 4.0;
/// An object within this distance of a cell, cells, may be the one that was seen in it.
const NEAR_CELLS: i32 = 2;

/// The grid that is matched: the integer sum of the active submap and of closed ones, with its published form.
#[derive(Debug)]
pub(crate) struct Window {
    tiles: TileDirectory<Box<WindowTile>>,
    scores: Scores,
    /// Only these tiles are published.
    share: TileShare,
    scan: u32,
    /// Tiles that the active submap has evidence in.
    active: Vec<TileKey>,
    touched: Vec<TileKey>,
    retired: Vec<TileKey>,
    /// Those of the share that have changed.
    changed: Vec<TileKey>,
    /// Tiles that rays of the present scan cross, and the evidence that they leave there.
    crossed: Vec<TileKey>,
    crossing: Cell,
    /// Receives the marks of rays outside of any possible tile.
    nowhere: CrossedCells,
}

impl Window {
    pub(crate) fn new(settings: &Settings, share: TileShare) -> Self {
        Self {
            share,
            tiles: TileDirectory::default(),
            scores: Scores::new(settings),
            scan: 0,
            active: Vec::new(),
            touched: Vec::new(),
            retired: Vec::new(),
            changed: Vec::new(),
            crossed: Vec::new(),
            crossing: Cell::UNKNOWN,
            nowhere: CrossedCells::default(),
        }
    }

    /// Starts the next scan: what changes from here on is listed anew.
    pub(crate) fn begin_scan(&mut self) {
        self.scan = self.scan.checked_add(1).expect("fewer than 2^32 insertions");
        for key in self.touched.drain(..) {
            if let Some(tile) = self.tiles.get_mut(key) {
                tile.begin_scan();
            }
        }
        self.retired.clear();
    }

    /// Adds the evidence of crossed cells. Called once, after the last ray of a scan.
    pub(crate) fn end_rays(&mut self) {
        let mut crossed = std::mem::take(&mut self.crossed);
        for key in crossed.drain(..) {
            let tile = self.tiles.get_mut(key).expect("crossed tiles are in the window");
            if tile.observe_crossed(self.crossing, &mut self.scores) {
                note(key, tile, self.scan, &mut self.active, &mut self.touched);
            }
        }
        self.crossed = crossed;
    }

    /// Ends the scan and drops the tiles that retired.
    pub(crate) fn end_scan(&mut self) {
        self.retired.retain(|key| {
            let left = self.tiles.get(*key).is_some_and(|tile| !tile.in_active && !tile.is_known());
            left && self.tiles.remove(*key).is_some()
        });
        let share = self.share;
        self.retired.retain(|key| share.has(*key));
        self.touched.retain(|key| self.tiles.get(*key).is_some());
        self.touched.sort_unstable();
        self.changed.clear();
        self.changed.extend(self.touched.iter().filter(|key| share.has(**key)));
    }

    pub(crate) fn changed(&self) -> &[TileKey] {
        &self.changed
    }

    pub(crate) fn retired(&self) -> &[TileKey] {
        &self.retired
    }

    pub(crate) fn published(&self, key: TileKey) -> Option<&Tile> {
        self.tiles.get(key).map(|tile| &tile.published)
    }

    pub(crate) fn keys(&self) -> impl Iterator<Item = TileKey> {
        self.tiles.iter().map(|(key, _)| key).filter(|key| self.share.has(*key))
    }

    /// Whether a cell is known to be free, with nothing that stands near it.
    pub(crate) fn is_clear(&self, cell: CellIndex) -> bool {
        let tile_of = |cell: CellIndex| self.tiles.get(cell.tile());
        let stands = |cell: CellIndex| {
            tile_of(cell).is_some_and(|tile| {
                let evidence = tile.published.cells[cell.offset()];
                f64::from(evidence.occupied) >= ESTABLISHED_NAT * WEIGHT_SCALE
                    && evidence.occupied > evidence.free
            })
        };
        let known_free = tile_of(cell).is_some_and(|tile| {
            f64::from(tile.published.cells[cell.offset()].free) >= CLEAR_NAT * WEIGHT_SCALE
        });
        let around = -NEAR_CELLS..=NEAR_CELLS;
        known_free
            && around.clone().all(|dy| {
                around
                    .clone()
                    .all(|dx| !stands(CellIndex::new(cell.x.saturating_add(dx), cell.y.saturating_add(dy))))
            })
    }

    /// Keeps of a cell's evidence only that of the active submap for "free".
    pub(crate) fn clear(&mut self, cell: CellIndex) {
        self.leave(cell, |active| PackedCell { occupied: 0, ..active });
    }

    /// Removes all evidence of a cell.
    pub(crate) fn remove(&mut self, cell: CellIndex) {
        self.leave(cell, |_| PackedCell::UNKNOWN);
    }

    /// Keeps a part of the active submap's evidence of a cell.
    fn leave(&mut self, cell: CellIndex, part: impl Fn(PackedCell) -> PackedCell) {
        if let Some(tile) = self.tiles.get_mut(cell.tile()) {
            let left = part(tile.active(cell.offset()));
            tile.replace(cell.offset(), left, &mut self.scores);
            self.touch(cell.tile());
        }
    }

    /// Adds a closed submap's evidence to the sum.
    pub(crate) fn add_submap(&mut self, submap: &ClosedSubmap) {
        submap.tiles().iter().for_each(|tile| self.change_sums(tile, Cell::combine));
    }

    /// Subtracts a closed submap's evidence from the sum; its tiles retire if they hold nothing else.
    pub(crate) fn withdraw_submap(&mut self, submap: &ClosedSubmap) {
        for tile in submap.tiles() {
            self.change_sums(tile, |sum, evidence| {
                sum.withdraw(evidence).expect("the window holds what its submaps hold")
            });
            self.retired.push(tile.key());
        }
    }

    /// Changes the sum of each cell that a tile of a submap has evidence of.
    fn change_sums(&mut self, part: &ClosedTile, change: impl Fn(Cell, Cell) -> Cell) {
        let mut known = part.evidence().peekable();
        if known.peek().is_none() {
            return;
        }
        let tile = tile_at(&mut self.tiles, part.key(), self.scores.unknown());
        let Some(tile) = tile else { return };
        for (offset, evidence) in known {
            let sum = change(tile.sum(offset), evidence);
            tile.set_sum(offset, sum, &mut self.scores);
        }
        self.touch(part.key());
    }

    /// Removes all evidence; every tile retires.
    pub(crate) fn clear_all(&mut self) {
        self.retired.extend(self.tiles.iter().map(|(key, _)| key));
        for key in &self.retired {
            if let Some(tile) = self.tiles.get_mut(*key) {
                *tile = WindowTile::new(self.scores.unknown());
            }
        }
        self.active.clear();
    }

    /// Takes the active submap's cells out as closed tiles, sorted by key; the sum stays as it is.
    pub(crate) fn close_active(&mut self) -> Vec<SubmapTile> {
        let mut keys = std::mem::take(&mut self.active);
        let mut closed = Vec::with_capacity(keys.len());
        for key in keys.drain(..) {
            let tile = self.tiles.get_mut(key).expect("tiles with active evidence are in the window");
            tile.in_active = false;
            closed.push(SubmapTile::new(key, tile.take_active()));
        }
        self.active = keys;
        closed.sort_unstable_by_key(|tile| tile.key);
        closed
    }

    /// Lists a tile as changed.
    fn touch(&mut self, key: TileKey) {
        let tile = self.tiles.get_mut(key).expect("touched tiles are in the window");
        if tile.changed_by != self.scan {
            tile.changed_by = self.scan;
            self.touched.push(key);
        }
    }
}

/// The tile of the window at a key, made if need be; `None` absurdly far away.
#[inline]
fn tile_at(
    tiles: &mut TileDirectory<Box<WindowTile>>,
    key: TileKey,
    unknown_score: u16,
) -> Option<&mut WindowTile> {
    if tiles.get(key).is_none() {
        tiles.set(key, WindowTile::new(unknown_score)).ok()?;
    }
    tiles.get_mut(key).map(|tile| &mut **tile)
}

/// Lists a tile as changed by the scan, and as one of the active submap's.
fn note(
    key: TileKey,
    tile: &mut WindowTile,
    scan: u32,
    active: &mut Vec<TileKey>,
    changed: &mut Vec<TileKey>,
) {
    if tile.changed_by != scan {
        tile.changed_by = scan;
        changed.push(key);
    }
    if !tile.in_active {
        tile.in_active = true;
        active.push(key);
    }
}

impl ObservedCells for Window {
    #[inline]
    fn observe(&mut self, cell: CellIndex, evidence: Cell) {
        let key = cell.tile();
        // A cell absurdly far away is not part of any map.
        let tile = tile_at(&mut self.tiles, key, self.scores.unknown());
        let Some(tile) = tile else { return };
        if tile.observe(cell.offset(), evidence, &mut self.scores) {
            note(key, tile, self.scan, &mut self.active, &mut self.touched);
        }
    }

    /// Only marks the cells: rays cross each other near the robot, and a cell that many rays cross gets its evidence once.
    fn observe_ray(&mut self, mut ray: Ray, evidence: Cell) {
        self.crossing = evidence;
        while let Some(key) = ray.tile() {
            let tile = tile_at(&mut self.tiles, key, self.scores.unknown());
            let Some(tile) = tile else {
                ray.cross_tile(&mut self.nowhere);
                continue;
            };
            if tile.crossed_by != self.scan {
                tile.crossed_by = self.scan;
                self.crossed.push(key);
            }
            ray.cross_tile(&mut tile.crossed);
        }
    }
}
