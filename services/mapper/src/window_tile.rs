//! One tile of the window: the evidence of the active submap, the sum with the closed ones, and its published form.

use crate::score::Scores;
use flockslam_evidence::{Cell, PackedCell, TILE_CELLS, TILE_SIDE, Tile};
use flockslam_ray_insertion::CrossedCells;

/// Cells whose sums are changed together.
const GROUP: usize = 8;

/// A tile of the window.
#[derive(Debug)]
pub(crate) struct WindowTile {
    /// The published form: the evidence of the whole window, capped, and its scores.
    pub(crate) published: Tile,
    /// Evidence of the whole window, not capped, from the moment that a cell of the tile reaches the cap. Few tiles have such a cell.
    uncapped: Option<Box<[Cell; TILE_CELLS]>>,
    /// Evidence of the active submap, once there is some; capped as it will be when the submap is closed.
    active: Option<Box<[PackedCell; TILE_CELLS]>>,
    /// Cells that the present scan has observed, one bit each, row by row.
    observed: [u64; TILE_SIDE],
    /// Cells that its rays cross.
    pub(crate) crossed: CrossedCells,
    /// Scan that crossed the tile last.
    pub(crate) crossed_by: u32,
    /// Scan that changed the tile last.
    pub(crate) changed_by: u32,
    /// Whether the tile is in the list of the active submap.
    pub(crate) in_active: bool,
}

impl WindowTile {
    pub(crate) fn new(unknown_score: u16) -> Box<Self> {
        Box::new(Self {
            published: *Tile::unknown(unknown_score),
            uncapped: None,
            active: None,
            observed: [0; TILE_SIDE],
            crossed: CrossedCells::default(),
            crossed_by: 0,
            changed_by: 0,
            in_active: false,
        })
    }

    /// Drops what the last scan observed.
    pub(crate) fn begin_scan(&mut self) {
        self.observed = [0; TILE_SIDE];
    }

    /// Whether any cell has evidence.
    pub(crate) fn is_known(&self) -> bool {
        self.published.cells.iter().any(|cell| !cell.is_unknown())
    }

    /// Evidence of the whole window for a cell, not capped.
    #[inline]
    pub(crate) fn sum(&self, offset: usize) -> Cell {
        match &self.uncapped {
            Some(sums) => sums[offset],
            None => self.published.cells[offset].unpack(),
        }
    }

    /// Evidence of the active submap for a cell.
    pub(crate) fn active(&self, offset: usize) -> PackedCell {
        self.active.as_ref().map_or(PackedCell::UNKNOWN, |active| active[offset])
    }

    /// Replaces the evidence of a cell: that of the active submap, and with it that of the whole window.
    pub(crate) fn replace(&mut self, offset: usize, active: PackedCell, scores: &mut Scores) {
        if active != self.active(offset) {
            active_cells(&mut self.active)[offset] = active;
        }
        self.set_sum(offset, active.unpack(), scores);
    }

    /// Takes the evidence of the active submap out; the sum stays as it is.
    pub(crate) fn take_active(&mut self) -> Box<[PackedCell; TILE_CELLS]> {
        self.active.take().unwrap_or_else(unknown_cells)
    }

    /// Adds evidence to a cell; false when the scan has observed it before.
    pub(crate) fn observe(&mut self, offset: usize, evidence: Cell, scores: &mut Scores) -> bool {
        let (row, bit) = (&mut self.observed[offset / TILE_SIDE], 1 << (offset % TILE_SIDE));
        if *row & bit != 0 {
            return false;
        }
        *row |= bit;
        let active = &mut active_cells(&mut self.active)[offset];
        let before = active.unpack();
        *active = before.combine(evidence).pack();
        let after = active.unpack();
        let added = Cell { occupied: after.occupied - before.occupied, free: after.free - before.free };
        self.set_sum(offset, self.sum(offset).combine(added), scores);
        true
    }

    /// Adds the same evidence to all crossed cells that were not observed otherwise; false when there are none.
    pub(crate) fn observe_crossed(&mut self, evidence: Cell, scores: &mut Scores) -> bool {
        let evidence = evidence.pack();
        let mut any = false;
        for (row, crossed) in self.crossed.take().into_iter().enumerate() {
            let fresh = crossed & !self.observed[row];
            if fresh != 0 {
                any = true;
                self.observed[row] |= fresh;
                self.observe_row(row, fresh, evidence, scores);
            }
        }
        any
    }

    fn observe_row(&mut self, row: usize, cells: u64, evidence: PackedCell, scores: &mut Scores) {
        for (group, cells) in cells.to_le_bytes().into_iter().enumerate() {
            if cells != 0 {
                let first = row * TILE_SIDE + group * GROUP;
                let occupied = self.add_to_group(first, cells, evidence);
                if occupied || scores.gives_free() {
                    self.score_group(first, cells, scores);
                }
            }
        }
    }

    /// Adds evidence to those of eight cells whose bits are set: all eight at once, without a branch for each. True when one of
    /// the eight has evidence for "occupied".
    #[inline]
    fn add_to_group(&mut self, first: usize, cells: u8, evidence: PackedCell) -> bool {
        let added = masked(cells, evidence);
        let active = &mut active_cells(&mut self.active)[first..first + GROUP];
        let published = &mut self.published.cells[first..first + GROUP];
        let (mut occupied, mut capped) = (0, false);
        let mut more = [[0; 2]; GROUP];
        for (((active, published), more), added) in
            active.iter_mut().zip(&*published).zip(&mut more).zip(added)
        {
            let before = *active;
            active.occupied = before.occupied.saturating_add(added[0]);
            active.free = before.free.saturating_add(added[1]);
            *more = [active.occupied.wrapping_sub(before.occupied), active.free.wrapping_sub(before.free)];
            capped |= more[0] > u16::MAX - published.occupied || more[1] > u16::MAX - published.free;
        }
        if capped || self.uncapped.is_some() {
            let sums = &mut uncapped_cells(&mut self.uncapped, &self.published)[first..first + GROUP];
            for (sum, more) in sums.iter_mut().zip(&more) {
                sum.occupied = sum.occupied.wrapping_add(u32::from(more[0]));
                sum.free = sum.free.wrapping_add(u32::from(more[1]));
            }
        }
        // The published form is the sum capped, and a capped sum of capped numbers is the same.
        for (published, more) in self.published.cells[first..first + GROUP].iter_mut().zip(&more) {
            published.occupied = published.occupied.saturating_add(more[0]);
            published.free = published.free.saturating_add(more[1]);
            occupied |= published.occupied;
        }
        occupied != 0
    }

    fn score_group(&mut self, first: usize, cells: u8, scores: &mut Scores) {
        for cell in 0..GROUP {
            let sum = self.sum(first + cell);
            if cells >> cell & 1 == 1 && (sum.occupied > 0 || scores.gives_free()) {
                self.published.set_score(first + cell, scores.of(sum));
            }
        }
    }

    /// Replaces the sum of a cell, and what is published of it.
    pub(crate) fn set_sum(&mut self, offset: usize, sum: Cell, scores: &mut Scores) {
        let had_occupied = self.published.cells[offset].occupied > 0;
        let published = sum.pack();
        if self.uncapped.is_some() || published.unpack() != sum {
            uncapped_cells(&mut self.uncapped, &self.published)[offset] = sum;
        }
        self.published.cells[offset] = published;
        if had_occupied || sum.occupied > 0 || scores.gives_free() {
            self.published.set_score(offset, scores.of(sum));
        }
    }
}

fn unknown_cells() -> Box<[PackedCell; TILE_CELLS]> {
    Box::new([PackedCell::UNKNOWN; TILE_CELLS])
}

/// The cells of the active submap, made if need be.
#[inline]
fn active_cells(active: &mut Option<Box<[PackedCell; TILE_CELLS]>>) -> &mut [PackedCell; TILE_CELLS] {
    active.get_or_insert_with(unknown_cells)
}

/// The sums that are not capped. Until now none was above the cap.
#[inline]
fn uncapped_cells<'a>(
    uncapped: &'a mut Option<Box<[Cell; TILE_CELLS]>>,
    published: &Tile,
) -> &'a mut [Cell; TILE_CELLS] {
    uncapped.get_or_insert_with(|| {
        let mut sums = Box::new([Cell::UNKNOWN; TILE_CELLS]);
        sums.iter_mut().zip(&published.cells).for_each(|(sum, cell)| *sum = cell.unpack());
        sums
    })
}

/// The evidence for each of eight cells whose bit is set, nothing for the others.
#[inline]
fn masked(cells: u8, evidence: PackedCell) -> [[u16; 2]; GROUP] {
    let mut added = [[0; 2]; GROUP];
    for (cell, added) in added.iter_mut().enumerate() {
        let mask = 0u16.wrapping_sub(u16::from(cells >> cell & 1));
        *added = [evidence.occupied & mask, evidence.free & mask];
    }
    added
}
