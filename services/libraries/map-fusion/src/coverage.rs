//! Which submaps know something in which blocks of the fused map: from this follows which submap newer ones cover.

use crate::Footprint;
use flockslam_evidence::TileKey;
use std::collections::BTreeMap;

/// Which submaps know something where, in blocks of 8 × 8 cells of the fused map.
#[derive(Debug, Default)]
pub struct Coverage {
    /// By tile: the submaps that know something in it, in ascending order, with their blocks.
    tiles: BTreeMap<TileKey, Vec<(u32, u64)>>,
}

impl Coverage {
    /// Counts a submap in.
    pub fn add(&mut self, number: u32, footprint: &Footprint) {
        for (key, blocks) in footprint.tiles() {
            let submaps = self.tiles.entry(*key).or_default();
            let place = submaps.partition_point(|(other, _)| *other < number);
            submaps.insert(place, (number, *blocks));
        }
    }

    /// Counts a submap out again.
    pub fn remove(&mut self, number: u32, footprint: &Footprint) {
        for (key, _) in footprint.tiles() {
            if let Some(submaps) = self.tiles.get_mut(key) {
                submaps.retain(|(other, _)| *other != number);
                if submaps.is_empty() {
                    self.tiles.remove(key);
                }
            }
        }
    }

    /// Number of blocks with evidence of some submap.
    pub fn blocks(&self) -> u64 {
        let known = |submaps: &Vec<(u32, u64)>| submaps.iter().fold(0, |known, (_, blocks)| known | blocks);
        self.tiles.values().map(|submaps| u64::from(known(submaps).count_ones())).sum()
    }

    /// In how many of a submap's blocks at least `times` newer ones know something too; `times` is positive.
    pub fn covered(&self, number: u32, footprint: &Footprint, times: usize) -> u32 {
        let covered = footprint.tiles().iter().map(|(key, blocks)| {
            let submaps = self.tiles.get(key).map_or(&[][..], Vec::as_slice);
            let newer = &submaps[submaps.partition_point(|(other, _)| *other <= number)..];
            (blocks & at_least(newer.iter().map(|(_, blocks)| *blocks), times)).count_ones()
        });
        covered.sum()
    }
}

/// The bits that are set in at least `times` of the words.
fn at_least(words: impl Iterator<Item = u64>, times: usize) -> u64 {
    // Layer k: the bits that have been set in more than k words.
    let mut layers = vec![0; times];
    for mut word in words {
        for layer in &mut layers {
            (*layer, word) = (*layer | word, *layer & word);
        }
    }
    layers[times - 1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_are_counted(words in proptest::collection::vec(any::<u64>(), 0..20), times in 1usize..9) {
            let counted = at_least(words.iter().copied(), times);
            for bit in 0..64 {
                let count = words.iter().filter(|word| **word >> bit & 1 == 1).count();
                prop_assert_eq!(counted >> bit & 1 == 1, count >= times);
            }
        }
    }
}
