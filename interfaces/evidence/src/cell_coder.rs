//! The model by which the cells of a submap are range coded: each cell is predicted from its neighbours to the left and
//! below. The same code writes and reads.

use crate::range_coder::{BinaryCoder, Likelihood};
use crate::weight_levels::CellLevels;
use crate::{TILE_CELLS, TILE_SIDE};

/// Cells of a row that are said to be empty with one bit.
pub(crate) const CHUNK: usize = 8;
/// Kinds of cells that contexts distinguish: unknown, free by level, occupied.
const CLASSES: usize = 32;
/// Places that five bits can distinguish.
const PLACES: usize = 32;
/// Places near a prediction that are tried before any.
const NEAR: usize = 5;

/// Places of a cell's weights among their levels, for "occupied" and for "free".
pub type Symbol = [u8; 2];

/// What is learned about the cells of a submap while they are coded, tile by tile: each is foreseen by its neighbours to the
/// left and below.
pub struct CellModel {
    /// Whether places near a prediction are tried before any; submaps of version 2 were coded without.
    tries_near: bool,
    /// Bits of a place, for "occupied" and for "free".
    bits: [u32; 2],
    chunk_is_empty: [Likelihood; 4],
    first_prediction: Box<[Likelihood; CLASSES * CLASSES]>,
    second_prediction: Box<[Likelihood; CLASSES * CLASSES]>,
    is_occupied: [Likelihood; 4],
    occupied: [Likelihood; PLACES],
    free_if_occupied: [Likelihood; PLACES],
    /// By class of the prediction: that the place is one near it.
    near: [[Likelihood; NEAR]; CLASSES],
    free: Box<[[Likelihood; PLACES]; CLASSES]>,
}

impl CellModel {
    /// A model of cells with these levels that has seen none yet.
    pub fn new(levels: &CellLevels) -> Self {
        let pairs = || Box::new([Likelihood::default(); CLASSES * CLASSES]);
        let bits = |count: usize| usize::BITS - count.leading_zeros();
        Self {
            tries_near: true,
            bits: [bits(levels.occupied.weights().len()), bits(levels.free.weights().len())],
            chunk_is_empty: Default::default(),
            first_prediction: pairs(),
            second_prediction: pairs(),
            is_occupied: Default::default(),
            occupied: [Likelihood::default(); PLACES],
            free_if_occupied: [Likelihood::default(); PLACES],
            near: [[Likelihood::default(); NEAR]; CLASSES],
            free: Box::new([[Likelihood::default(); PLACES]; CLASSES]),
        }
    }

    /// The model that cells of version 2 were coded by.
    pub fn of_version_2(levels: &CellLevels) -> Self {
        Self { tries_near: false, ..Self::new(levels) }
    }

    /// Writes the cells of a tile, or fills them with what is read. `known` are its blocks of 8 × 8 cells that are not empty (bit = row of
    /// blocks · 8 + column).
    pub fn code(&mut self, coder: &mut impl BinaryCoder, known: u64, cells: &mut [Symbol; TILE_CELLS]) {
        let mut below = [[0; 2]; TILE_SIDE];
        for (blocks, rows) in known.to_le_bytes().into_iter().zip(cells.chunks_mut(TILE_SIDE * CHUNK)) {
            self.code_rows(coder, blocks, rows, &mut below);
        }
    }

    /// The same of a row of blocks. `below` is the row of cells below it, and then its last one.
    pub fn code_rows(
        &mut self,
        coder: &mut impl BinaryCoder,
        blocks: u8,
        rows: &mut [Symbol],
        below: &mut [Symbol; TILE_SIDE],
    ) {
        for row in rows.as_chunks_mut::<TILE_SIDE>().0 {
            for chunk in 0..TILE_SIDE / CHUNK {
                if blocks >> chunk & 1 == 1 {
                    self.code_chunk(coder, row, below, chunk * CHUNK);
                } else {
                    row[chunk * CHUNK..(chunk + 1) * CHUNK].fill([0; 2]);
                }
            }
            *below = *row;
        }
    }

    fn code_chunk(
        &mut self,
        coder: &mut impl BinaryCoder,
        row: &mut [Symbol; TILE_SIDE],
        below: &[Symbol; TILE_SIDE],
        start: usize,
    ) {
        let end = start + CHUNK;
        let before = if start > 0 { row[start - 1] } else { [0; 2] };
        let context = usize::from(is_empty(&below[start..end])) + 2 * usize::from(before == [0; 2]);
        if coder.code(&mut self.chunk_is_empty[context], is_empty(&row[start..end])) {
            row[start..end].fill([0; 2]);
            return;
        }
        let mut left = before;
        let mut corner = if start > 0 { below[start - 1] } else { [0; 2] };
        for (cell, below) in row[start..end].iter_mut().zip(&below[start..end]) {
            // Where the row below did not change from the left, this one is likely to be like it.
            let (first, second) = if corner == left { (*below, left) } else { (left, *below) };
            *cell = self.code_cell(coder, first, second, *cell);
            (left, corner) = (*cell, *below);
        }
    }

    #[inline]
    fn code_cell(
        &mut self,
        coder: &mut impl BinaryCoder,
        first: Symbol,
        second: Symbol,
        cell: Symbol,
    ) -> Symbol {
        let context = class(first) * CLASSES + class(second);
        if coder.code(&mut self.first_prediction[context], cell == first) {
            return first;
        }
        if second != first && coder.code(&mut self.second_prediction[context], cell == second) {
            return second;
        }
        let near = usize::from(first[0] > 0) + 2 * usize::from(second[0] > 0);
        let [occupied_bits, free_bits] = self.bits;
        if coder.code(&mut self.is_occupied[near], cell[0] > 0) {
            let occupied = code_place(coder, &mut self.occupied, occupied_bits, cell[0]);
            [occupied, code_place(coder, &mut self.free_if_occupied, free_bits, cell[1])]
        } else {
            [0, self.code_free(coder, first, second, cell[1])]
        }
    }

    /// The place of a cell without evidence for "occupied" that neither prediction is right about: unknown, one near the prediction, or any.
    #[inline]
    fn code_free(&mut self, coder: &mut impl BinaryCoder, first: Symbol, second: Symbol, place: u8) -> u8 {
        let class = class(first);
        let is_free = |cell: &Symbol| cell[0] == 0 && cell[1] > 0;
        if let Some([_, base]) = [first, second].into_iter().find(is_free).filter(|_| self.tries_near) {
            let candidates: [u8; NEAR] = [0, base + 1, base - 1, base + 2, base.saturating_sub(2)];
            for (likelihood, candidate) in self.near[class].iter_mut().zip(candidates) {
                let is_excluded = [first, second].contains(&[0, candidate]);
                if !is_excluded && coder.code(likelihood, place == candidate) {
                    return candidate;
                }
            }
        }
        code_place(coder, &mut self.free[class], self.bits[1], place)
    }
}

fn is_empty(cells: &[Symbol]) -> bool {
    cells.iter().all(|cell| *cell == [0; 2])
}

fn class(cell: Symbol) -> usize {
    if cell[0] > 0 { CLASSES - 1 } else { usize::from(cell[1]).min(CLASSES - 2) }
}

/// So many bits, the highest first, each in the context of those before it.
#[inline]
fn code_place(coder: &mut impl BinaryCoder, tree: &mut [Likelihood; PLACES], bits: u32, place: u8) -> u8 {
    let mut node = 1;
    for bit in (0..bits).rev() {
        node = 2 * node + usize::from(coder.code(&mut tree[node], place >> bit & 1 == 1));
    }
    (node - (1 << bits)) as u8
}
