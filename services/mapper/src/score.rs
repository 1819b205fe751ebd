//! Matching scores of cells from their evidence, with a memory of those computed before.

use crate::settings::{ReadOut, Settings};
use flockslam_evidence::{Cell, Masses, WEIGHT_SCALE};

/// Places of the memory: evidence comes in few different sums, since every hit and every miss weighs the same.
const PLACES: usize = 1024;

/// Scores of cells, computed once for each sum of evidence that is met often.
#[derive(Debug)]
pub(crate) struct Scores {
    read_out: ReadOut,
    occupied_cap: u32,
    free_cap: u32,
    known: Box<[(Cell, u16); PLACES]>,
}

impl Scores {
    pub(crate) fn new(settings: &Settings) -> Self {
        let cap = |nat: f64| Cell::from_weights(nat, 0.0).occupied;
        let read_out = settings.read_out();
        let (occupied_nat, free_nat) = read_out.caps_nat();
        Self {
            read_out,
            occupied_cap: cap(occupied_nat),
            free_cap: cap(free_nat),
            known: Box::new([(Cell::UNKNOWN, read_out.unknown()); PLACES]),
        }
    }

    /// Score of a cell without evidence.
    pub(crate) fn unknown(&self) -> u16 {
        self.read_out.unknown()
    }

    /// Whether cells without evidence for "occupied" may have different scores.
    pub(crate) fn gives_free(&self) -> bool {
        self.read_out == ReadOut::Vinyslam
    }

    /// Score of a cell with this sum of evidence, each weight counted up to its cap.
    #[inline]
    pub(crate) fn of(&mut self, sum: Cell) -> u16 {
        let counted =
            Cell { occupied: sum.occupied.min(self.occupied_cap), free: sum.free.min(self.free_cap) };
        // Multiplicative hashing (Knuth, volume 3, 6.4); the high bits are the well mixed ones.
        let mixed = counted.occupied.wrapping_mul(0x9E37_79B1) ^ counted.free.wrapping_mul(0x85EB_CA77);
        let place = &mut self.known[(mixed >> (u32::BITS - PLACES.trailing_zeros())) as usize];
        if place.0 != counted {
            *place = (counted, score(self.read_out, counted));
        }
        place.1
    }
}

#[cold]
#[inline(never)]
fn score(read_out: ReadOut, counted: Cell) -> u16 {
    let nat = |weight: u32| f64::from(weight) / WEIGHT_SCALE;
    read_out.score(Masses::from_weights(nat(counted.occupied), nat(counted.free)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cached_scores_are_those_of_the_masses() {
        let settings = Settings::default();
        let mut scores = Scores::new(&settings);
        assert_eq!(scores.of(Cell::UNKNOWN), 0);
        for i in (0..200_000u32).chain(0..200_000) {
            let cell = Cell { occupied: i.wrapping_mul(613) % 80_000, free: i.wrapping_mul(89) % 20_000 };
            assert_eq!(scores.of(cell), settings.read_out().score(cell.masses()));
        }
    }
}
