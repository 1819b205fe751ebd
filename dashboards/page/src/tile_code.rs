//! Run-length code of a tile's shades, from bytes and back.

use crate::shade::{DARKEST, Shades};
use flockslam_evidence::TILE_CELLS;

/// Runs up to this length are in the byte of their shade.
const SHORT_RUN: usize = 15;

/// A tile's shades as runs, row by row: a byte with the shade in its upper half and the length in its lower one. Length 0 means that
/// two bytes follow, the length less 1, low byte first.
///
/// ```
/// use flockslam_evidence::TILE_CELLS;
/// use flockslam_page::{decode_tile, encode_tile};
///
/// let mut shades = [1; TILE_CELLS];
/// shades[70] = 15;
/// let code = encode_tile(&shades);
/// assert_eq!(code.len(), 3 + 1 + 3);
/// assert_eq!(decode_tile(&code).as_deref(), Some(&shades));
/// assert_eq!(decode_tile(&code[1..]), None);
/// ```
pub fn encode_tile(shades: &Shades) -> Vec<u8> {
    let mut code = Vec::with_capacity(256);
    for run in shades.chunk_by(|a, b| a == b) {
        let shade = run[0] << 4;
        debug_assert!(run[0] <= DARKEST);
        if run.len() <= SHORT_RUN {
            code.push(shade | run.len() as u8);
        } else {
            code.push(shade);
            code.extend_from_slice(&(run.len() as u16 - 1).to_le_bytes());
        }
    }
    code
}

/// The shades that were encoded; `None` when the code is not one of a whole tile.
pub fn decode_tile(code: &[u8]) -> Option<Box<Shades>> {
    let mut shades = Box::new([0; TILE_CELLS]);
    let (mut done, mut rest) = (0, code);
    while let [head, tail @ ..] = rest {
        let (length, tail) = match (head & 15, tail) {
            (0, [low, high, tail @ ..]) => (usize::from(u16::from_le_bytes([*low, *high])) + 1, tail),
            (0, _) => return None,
            (length, tail) => (usize::from(length), tail),
        };
        shades.get_mut(done..done + length)?.fill(head >> 4);
        (done, rest) = (done + length, tail);
    }
    (done == TILE_CELLS).then_some(shades)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_tile_comes_back(runs in proptest::collection::vec((0..=DARKEST, 1usize..200), 1..400)) {
            let mut shades = [0; TILE_CELLS];
            let all = runs.iter().flat_map(|(shade, length)| std::iter::repeat_n(*shade, *length));
            shades.iter_mut().zip(all.cycle()).for_each(|(to, shade)| *to = shade);
            let code = encode_tile(&shades);
            prop_assert!(code.len() <= TILE_CELLS);
            prop_assert_eq!(*decode_tile(&code).unwrap(), shades);
        }

        #[test]
        fn foreign_bytes_are_a_tile_or_nothing(code in proptest::collection::vec(any::<u8>(), 0..270)) {
            if let Some(shades) = decode_tile(&code) {
                prop_assert_eq!(decode_tile(&encode_tile(&shades)), Some(shades));
            }
            // The short runs alone are less than a tile; with a long one for the rest they are one.
            let mut code: Vec<u8> = code.into_iter().filter(|byte| byte & 15 != 0).collect();
            prop_assert_eq!(decode_tile(&code), None);
            let cells: usize = code.iter().map(|byte| usize::from(byte & 15)).sum();
            let rest = (TILE_CELLS - cells - 1) as u16;
            code.push(DARKEST << 4);
            code.extend_from_slice(&rest.to_le_bytes());
            let shades = decode_tile(&code).unwrap();
            prop_assert!(shades[cells..].iter().all(|shade| *shade == DARKEST));
            code.push(1);
            prop_assert_eq!(decode_tile(&code), None);
        }
    }

    #[test]
    fn plain_tiles_are_short_and_the_worst_is_no_longer_than_its_cells() {
        assert_eq!(encode_tile(&[3; TILE_CELLS]).len(), 3);
        let worst = std::array::from_fn(|place| (place % 2) as u8);
        assert_eq!(encode_tile(&worst).len(), TILE_CELLS);
    }
}
