use crate::settings::{ReadOut, Settings};
use flockslam_evidence::{
    Cell, CellIndex, Masses, ObservedCells, PackedCell, Submap, SubmapTile, TILE_CELLS, Tile, TileDirectory,
    TileKey, WEIGHT_SCALE,
};

/// The grid that is matched: the integer sum of the active submap and of closed ones, with its published form.
#[derive(Debug)]
pub(crate) struct Window {
    tiles: TileDirectory<Box<WindowTile>>,
    read_out: ReadOut,
    occupied_cap: u32,
    free_cap: u32,
    scan: u32,
    /// Tiles that the active submap has evidence in.
    active: Vec<TileKey>,
    changed: Vec<TileKey>,
    retired: Vec<TileKey>,
    rescored: Vec<CellIndex>,
}

/// A tile of the window. What an observation touches lies together.
#[derive(Debug)]
struct WindowTile {
    published: Tile,
    cells: [WindowCell; TILE_CELLS],
    /// Scan that changed the tile last.
    changed_by: u32,
    /// Whether the tile is in the list of the active submap.
    in_active: bool,
}

#[derive(Clone, Copy, Debug)]
struct WindowCell {
    /// Evidence of the whole window.
    sum: Cell,
    /// Evidence of the active submap; capped as it will be when the submap is closed.
    active: PackedCell,
    /// Last scan that observed the cell.
    observed_by: u32,
}

impl WindowTile {
    fn new(unknown_score: u16) -> Box<Self> {
        let empty = WindowCell { sum: Cell::UNKNOWN, active: PackedCell::UNKNOWN, observed_by: 0 };
        Box::new(Self {
            published: *Tile::unknown(unknown_score),
            cells: [empty; TILE_CELLS],
            changed_by: 0,
            in_active: false,
        })
    }
}

impl Window {
    pub(crate) fn new(settings: &Settings) -> Self {
        let cap = |nat: f64| Cell::from_weights(nat, 0.0).occupied;
        Self {
            tiles: TileDirectory::default(),
            read_out: settings.read_out,
            occupied_cap: cap(settings.occupied_cap_nat),
            free_cap: cap(settings.free_cap_nat),
            scan: 0,
            active: Vec::new(),
            changed: Vec::new(),
            retired: Vec::new(),
            rescored: Vec::new(),
        }
    }

    /// Starts the next scan: what changes from here on is listed anew.
    pub(crate) fn begin_scan(&mut self) {
        self.scan = self.scan.checked_add(1).expect("fewer than 2^32 insertions");
        self.changed.clear();
        self.retired.clear();
    }

    /// Brings the scores of all touched cells up to date and forgets the tiles that retired.
    pub(crate) fn end_scan(&mut self) {
        self.retired.retain(|key| {
            let known = |tile: &WindowTile| tile.cells.iter().any(|cell| !cell.sum.is_unknown());
            let left = self.tiles.get(*key).is_some_and(|tile| !tile.in_active && !known(tile));
            left && self.tiles.remove(*key).is_some()
        });
        let mut rescored = std::mem::take(&mut self.rescored);
        for cell in rescored.drain(..) {
            let Some(tile) = self.tiles.get_mut(cell.tile()) else { continue };
            let sum = tile.cells[cell.offset()].sum;
            let score = score(self.read_out, sum, self.occupied_cap, self.free_cap);
            tile.published.set_score(cell.offset(), score);
        }
        self.rescored = rescored;
        self.changed.retain(|key| self.tiles.get(*key).is_some());
        self.changed.sort_unstable();
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
        self.tiles.iter().map(|(key, _)| key)
    }

    /// Leaves of a cell's evidence only the active submap's for "free".
    pub(crate) fn clear(&mut self, cell: CellIndex) {
        if let Some(tile) = self.tiles.get_mut(cell.tile()) {
            let place = &mut tile.cells[cell.offset()];
            place.active.occupied = 0;
            place.sum = place.active.unpack();
            self.touch(cell);
        }
    }

    /// Takes evidence that was in the window's sum out of a cell.
    fn withdraw(&mut self, cell: CellIndex, evidence: PackedCell) {
        if evidence.is_unknown() {
            return;
        }
        let tile = self.tiles.get_mut(cell.tile()).expect("evidence lies in a tile");
        let sum = tile.cells[cell.offset()].sum.withdraw(evidence.unpack());
        tile.cells[cell.offset()].sum = sum.expect("the window holds what its submaps hold");
        self.touch(cell);
    }

    /// Puts a closed submap's evidence into the sum.
    pub(crate) fn add_submap(&mut self, submap: &Submap) {
        for tile in &submap.tiles {
            for offset in 0..TILE_CELLS {
                let evidence = tile.cell(offset);
                if evidence.is_unknown() || !self.ensure(tile.key) {
                    continue;
                }
                let cell = tile.key.cell(offset);
                let place = &mut self.tiles.get_mut(tile.key).expect("ensured").cells[offset];
                place.sum = place.sum.combine(evidence.unpack());
                self.touch(cell);
            }
        }
    }

    /// Takes a closed submap's evidence out of the sum; its tiles retire if nothing else is in them.
    pub(crate) fn withdraw_submap(&mut self, submap: &Submap) {
        for tile in &submap.tiles {
            for offset in 0..TILE_CELLS {
                self.withdraw(tile.key.cell(offset), tile.cell(offset));
            }
            self.retired.push(tile.key);
        }
    }

    /// Takes the active submap's cells out as closed tiles, sorted by key; the sum stays as it is.
    pub(crate) fn close_active(&mut self) -> Vec<SubmapTile> {
        let mut keys = std::mem::take(&mut self.active);
        let mut closed = Vec::with_capacity(keys.len());
        for key in keys.drain(..) {
            let tile = self.tiles.get_mut(key).expect("tiles with active evidence are in the window");
            tile.in_active = false;
            let mut cells = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
            for (to, from) in cells.iter_mut().zip(&mut tile.cells) {
                *to = std::mem::take(&mut from.active);
            }
            closed.push(SubmapTile::new(key, cells));
        }
        self.active = keys;
        closed.sort_unstable_by_key(|tile| tile.key);
        closed
    }

    fn ensure(&mut self, key: TileKey) -> bool {
        self.tiles.get(key).is_some() || self.tiles.set(key, WindowTile::new(self.read_out.unknown())).is_ok()
    }

    /// Publishes a cell's changed sum.
    fn touch(&mut self, cell: CellIndex) {
        let scan = self.scan;
        let tile = self.tiles.get_mut(cell.tile()).expect("touched cells lie in tiles");
        let sum = tile.cells[cell.offset()].sum;
        tile.published.cells[cell.offset()] = sum.pack();
        self.rescored.push(cell);
        if tile.changed_by != scan {
            tile.changed_by = scan;
            self.changed.push(cell.tile());
        }
    }
}

impl ObservedCells for Window {
    #[inline]
    fn observe(&mut self, cell: CellIndex, evidence: Cell) {
        let (key, offset, scan) = (cell.tile(), cell.offset(), self.scan);
        let tile = match self.tiles.get_mut(key) {
            Some(tile) => tile,
            None => {
                // A cell absurdly far away is not part of any map.
                if !self.ensure(key) {
                    return;
                }
                self.tiles.get_mut(key).expect("ensured")
            }
        };
        let place = &mut tile.cells[offset];
        if place.observed_by == scan {
            return;
        }
        place.observed_by = scan;
        let before = place.active.unpack();
        place.active = before.combine(evidence).pack();
        let after = place.active.unpack();
        place.sum = place
            .sum
            .combine(Cell { occupied: after.occupied - before.occupied, free: after.free - before.free });
        tile.published.cells[offset] = place.sum.pack();
        if !tile.in_active {
            tile.in_active = true;
            self.active.push(key);
        }
        if self.read_out == ReadOut::Vinyslam || place.sum.occupied > 0 {
            self.rescored.push(cell);
        }
        if tile.changed_by != scan {
            tile.changed_by = scan;
            self.changed.push(key);
        }
    }
}

/// Score of a cell's evidence, each weight counted up to its cap (units of the fixed point).
fn score(read_out: ReadOut, sum: Cell, occupied_cap: u32, free_cap: u32) -> u16 {
    let nat = |weight: u32| f64::from(weight) / WEIGHT_SCALE;
    let masses = Masses::from_weights(nat(sum.occupied.min(occupied_cap)), nat(sum.free.min(free_cap)));
    read_out.score(masses)
}
