//! Quantisation of the weights of a submap: at most 27 levels for each of the two weights, each the mean of what it
//! stands for.

use crate::submap_outline::block_rows;
use crate::{PackedCell, Submap, SubmapOutline, SubmapTile, TileKey};

/// Kinds of weights, each half again as great as the one before: all of `1 … 65535`.
const BINS: usize = 27;
/// The least weight of each kind.
const BOUNDS: [u16; BINS] = bounds();
/// The kind of each weight.
static KINDS: [u8; 1 << 16] = kinds();

/// The levels that weights are stored in: of those of a submap that differ by less than half, the mean.
///
/// Sums are kept to within rounding, and the most frequent values, one and two observations, are exact
/// where all observations weigh the same.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Levels {
    /// The levels, each of another kind, in ascending order.
    weights: Vec<u16>,
    /// By kind: the place of its level, from 1.
    places: [u8; BINS + 1],
}

/// Levels of both weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellLevels {
    /// Of the weights for "occupied".
    pub occupied: Levels,
    /// Of the weights for "free".
    pub free: Levels,
}

impl CellLevels {
    /// The levels of a submap, whose tiles have evidence in these blocks; what was cleared counts like the rest.
    pub fn of(tiles: &[SubmapTile], blocks: &[(TileKey, u64)]) -> Self {
        let mut sums = [[(0u64, 0u64); BINS + 1]; 2];
        for (tile, (_, blocks)) in tiles.iter().zip(blocks) {
            for cell in block_rows(*blocks).flat_map(|row| &tile.cells[row]) {
                for (sums, weight) in sums.iter_mut().zip([cell.occupied, cell.free]) {
                    let (sum, count) = &mut sums[usize::from(kind(weight))];
                    (*sum, *count) = (*sum + u64::from(weight), *count + 1);
                }
            }
        }
        let [occupied, free] = sums.map(|sums| {
            let means = sums[1..].iter().filter(|(_, count)| *count > 0);
            means.map(|(sum, count)| ((sum + count / 2) / count) as u16).collect()
        });
        Self { occupied, free }
    }

    /// A cell's places among the levels, 0 for no weight.
    #[inline]
    pub fn places(&self, cell: PackedCell) -> [u8; 2] {
        [self.occupied.place(cell.occupied), self.free.place(cell.free)]
    }

    /// The cell with these places; `None` when there is no such level.
    #[inline]
    pub fn cell(&self, [occupied, free]: [u8; 2]) -> Option<PackedCell> {
        Some(PackedCell { occupied: self.occupied.weight(occupied)?, free: self.free.weight(free)? })
    }
}

impl Levels {
    /// The levels, in ascending order.
    pub fn weights(&self) -> &[u16] {
        &self.weights
    }

    /// Adds a level above the others; false when it is none, or not of another kind than they.
    pub fn push(&mut self, weight: u16) -> bool {
        let kind = kind(weight);
        if kind <= self.weights.last().map_or(0, |last| self::kind(*last)) {
            return false;
        }
        self.weights.push(weight);
        self.places[usize::from(kind)] = self.weights.len() as u8;
        true
    }

    #[inline]
    fn place(&self, weight: u16) -> u8 {
        self.places[usize::from(kind(weight))]
    }

    #[inline]
    fn weight(&self, place: u8) -> Option<u16> {
        match place.checked_sub(1) {
            None => Some(0),
            Some(index) => self.weights.get(usize::from(index)).copied(),
        }
    }
}

impl FromIterator<u16> for Levels {
    fn from_iter<I: IntoIterator<Item = u16>>(weights: I) -> Self {
        let mut levels = Self::default();
        weights.into_iter().for_each(|weight| assert!(levels.push(weight), "means keep their order"));
        levels
    }
}

impl Submap {
    /// The submap as it is stored: every weight replaced by its level. Doing it again changes nothing.
    #[must_use]
    pub fn quantised(&self) -> Submap {
        let levels = CellLevels::of(&self.tiles, &SubmapOutline::of(self).blocks);
        let mut submap = self.clone();
        for cell in submap.tiles.iter_mut().flat_map(|tile| tile.cells.iter_mut()) {
            *cell = levels.cell(levels.places(*cell)).expect("every weight has its level");
        }
        submap
    }
}

impl Submap {
    /// The submap as it is published: as [`Self::quantised`], with levels that differ by a factor of five for "free" and of two for
    /// "occupied". It takes a good deal less room, and all sums stay what they are. Doing it again changes nothing.
    #[must_use]
    pub fn coarsened(&self) -> Submap {
        let mut sums = [[(0u64, 0u64); BINS + 1]; 2];
        let mut submap = self.quantised();
        for cell in submap.tiles.iter().flat_map(|tile| tile.cells.iter()) {
            for (axis, weight) in [cell.occupied, cell.free].into_iter().enumerate() {
                let (sum, count) = &mut sums[axis][coarse(axis, weight)];
                (*sum, *count) = (*sum + u64::from(weight), *count + 1);
            }
        }
        let means = sums
            .map(|sums| sums.map(|(sum, count)| (sum + count / 2).checked_div(count).unwrap_or(0) as u16));
        for cell in submap.tiles.iter_mut().flat_map(|tile| tile.cells.iter_mut()) {
            let [occupied, free] = [cell.occupied, cell.free];
            *cell = PackedCell { occupied: means[0][coarse(0, occupied)], free: means[1][coarse(1, free)] };
        }
        submap
    }
}

/// The coarser kind of a weight: of one or two observations as it is, of more two kinds in one where it speaks for "occupied" (0), and four where
/// it speaks for "free" (1).
fn coarse(axis: usize, weight: u16) -> usize {
    let kind = usize::from(kind(weight));
    if kind <= 2 { kind } else { 3 + (kind - 3) / [2, 4][axis] }
}

/// The kind of a weight, from 1; 0 for no weight.
#[inline]
fn kind(weight: u16) -> u8 {
    KINDS[usize::from(weight)]
}

const fn bounds() -> [u16; BINS] {
    let mut bounds = [1u16; BINS];
    let mut i = 1;
    while i < BINS {
        // Rounded up: 1, 2, 3, 5, 8, 12, …
        bounds[i] = bounds[i - 1] + bounds[i - 1].div_ceil(2);
        i += 1;
    }
    bounds
}

const fn kinds() -> [u8; 1 << 16] {
    let mut kinds = [0; 1 << 16];
    let (mut weight, mut kind) = (1, 0);
    while weight < kinds.len() {
        if kind < BINS && BOUNDS[kind] as usize == weight {
            kind += 1;
        }
        kinds[weight] = kind as u8;
        weight += 1;
    }
    kinds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::submap_bytes::tests::submap;
    use proptest::prelude::*;

    #[test]
    fn kinds_cover_all_weights() {
        assert_eq!(BOUNDS[..6], [1, 2, 3, 5, 8, 12]);
        assert!(BOUNDS.windows(2).all(|pair| pair[0] < pair[1]));
        let next = u32::from(BOUNDS[BINS - 1]) * 3 / 2;
        assert!(next > u32::from(u16::MAX), "{next}");
        assert_eq!((kind(0), kind(1), usize::from(kind(u16::MAX))), (0, 1, BINS));
    }

    proptest! {
        #[test]
        fn a_published_submap_keeps_sums_and_is_coarsened_once(submap in submap()) {
            let coarse = submap.coarsened();
            prop_assert_eq!(&coarse.coarsened(), &coarse);
            prop_assert_eq!(&coarse.quantised(), &coarse);
            let sum = |submap: &Submap, pick: fn(&PackedCell) -> u16| -> i64 {
                submap.tiles.iter().flat_map(|tile| tile.cells.iter()).map(|cell| i64::from(pick(cell))).sum()
            };
            for pick in [|cell: &PackedCell| cell.occupied, |cell: &PackedCell| cell.free] {
                prop_assert!((sum(&coarse, pick) - sum(&submap, pick)).abs() <= 8192);
            }
            for (before, after) in submap.tiles.iter().zip(&coarse.tiles) {
                prop_assert_eq!(before.cleared, after.cleared);
                prop_assert!(before.cells.iter().zip(after.cells.iter()).all(|(a, b)| a.is_unknown() == b.is_unknown()));
            }
        }

        #[test]
        fn quantising_keeps_sums_and_ratios_and_is_done_once(submap in submap()) {
            let quantised = submap.quantised();
            prop_assert_eq!(&quantised.quantised(), &quantised);
            let mut sums = [0i64; 2];
            for (before, after) in submap.tiles.iter().zip(&quantised.tiles) {
                prop_assert_eq!(before.cleared, after.cleared);
                for (a, b) in before.cells.iter().zip(after.cells.iter()) {
                    for (sum, (a, b)) in sums.iter_mut().zip([(a.occupied, b.occupied), (a.free, b.free)]) {
                        let (a, b) = (i64::from(a), i64::from(b));
                        prop_assert!(2 * b <= 3 * a + 1 && 2 * a <= 3 * b + 1, "{} became {}", a, b);
                        *sum += b - a;
                    }
                }
            }
            // Each level is rounded by half a unit.
            prop_assert!(sums.iter().all(|sum| sum.abs() <= 4096), "{:?}", sums);
        }
    }
}
