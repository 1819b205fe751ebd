//! A bit map of one tile: which of its cells are crossed by the rays of a scan.

use flockslam_evidence::TILE_SIDE;

/// The cells of a tile that rays cross, one bit each: flat rays mark columns and steep ones rows, so that neighbouring
/// cells of a ray lie in different words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CrossedCells {
    /// Bit y of word x is cell (x, y).
    columns: [u64; TILE_SIDE],
    /// Bit x of word y is cell (x, y).
    rows: [u64; TILE_SIDE],
}

impl Default for CrossedCells {
    fn default() -> Self {
        Self { columns: [0; TILE_SIDE], rows: [0; TILE_SIDE] }
    }
}

impl CrossedCells {
    /// Words of rows for steep rays, of columns for flat ones.
    #[inline]
    pub(crate) fn words(&mut self, steep: bool) -> &mut [u64; TILE_SIDE] {
        if steep { &mut self.rows } else { &mut self.columns }
    }

    /// Takes the marks out, row by row: bit x of word y is cell (x, y).
    pub fn take(&mut self) -> [u64; TILE_SIDE] {
        let mut rows = std::mem::replace(&mut self.columns, [0; TILE_SIDE]);
        transpose(&mut rows);
        for (row, more) in rows.iter_mut().zip(&mut self.rows) {
            *row |= std::mem::take(more);
        }
        rows
    }
}

/// Swaps rows and columns of a square of bits, by swapping ever smaller blocks (Warren, Hacker's Delight, 7-3).
fn transpose(words: &mut [u64; TILE_SIDE]) {
    let mut width = TILE_SIDE / 2;
    let mut low_halves = u64::MAX >> width;
    while width > 0 {
        for pair in words.chunks_exact_mut(2 * width) {
            let (lower, upper) = pair.split_at_mut(width);
            for (a, b) in lower.iter_mut().zip(upper) {
                let swapped = (*a >> width ^ *b) & low_halves;
                *a ^= swapped << width;
                *b ^= swapped;
            }
        }
        width /= 2;
        low_halves ^= low_halves << width;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn marks_of_flat_and_steep_rays_come_out_together(
            marks in proptest::collection::vec((0..TILE_SIDE, 0..TILE_SIDE, any::<bool>()), 0..300)
        ) {
            let (mut crossed, mut expected) = (CrossedCells::default(), [0u64; TILE_SIDE]);
            for (x, y, steep) in marks {
                let (word, bit) = if steep { (y, x) } else { (x, y) };
                crossed.words(steep)[word] |= 1 << bit;
                expected[y] |= 1 << x;
            }
            prop_assert_eq!(crossed.take(), expected);
            prop_assert_eq!(crossed, CrossedCells::default());
        }
    }
}
