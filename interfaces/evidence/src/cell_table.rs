//! A table of fixed size with a value for each of the cells that were touched last.

use crate::CellIndex;

/// Places in a set of the table.
const WAYS: usize = 4;
/// Sets of the table, a power of two.
const SETS: usize = 1 << 13;

/// Keeps something about a bounded number of cells.
///
/// A table of fixed size in sets of four places. When a set is full, what was touched longest ago gives way: memory stays
/// bounded, and what is dropped does not depend on anything but the calls.
#[derive(Clone, Debug)]
pub struct CellTable<T> {
    places: Vec<Place<T>>,
    /// How many places of each set are taken: most cells that are asked for are not in the table, and this fits into the fastest memory.
    taken: Vec<u8>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Place<T> {
    cell: CellIndex,
    /// When it was touched last; 0: the place is free.
    touched: u32,
    value: T,
}

impl<T: Copy + Default> CellTable<T> {
    /// An empty table. All the memory that it will ever need is taken now.
    pub fn new() -> Self {
        Self { places: vec![Place::default(); SETS * WAYS], taken: vec![0; SETS] }
    }

    /// The entry of a cell – the default if it is not in the table –, touched at `now`, which must be
    /// positive and should never decrease.
    pub fn touch(&mut self, cell: CellIndex, now: u32) -> &mut T {
        let number = set_of(cell);
        let set = &mut self.places[number * WAYS..(number + 1) * WAYS];
        let place = match set.iter().position(|place| place.is_of(cell)) {
            Some(index) => &mut set[index],
            None => {
                let oldest = set.iter_mut().min_by_key(|place| place.touched).expect("a set has places");
                self.taken[number] += u8::from(oldest.touched == 0);
                *oldest = Place { cell, ..Place::default() };
                oldest
            }
        };
        place.touched = now.max(1);
        &mut place.value
    }

    /// Removes a cell.
    pub fn remove(&mut self, cell: CellIndex) {
        let number = set_of(cell);
        if self.taken[number] == 0 {
            return;
        }
        let set = &mut self.places[number * WAYS..(number + 1) * WAYS];
        if let Some(place) = set.iter_mut().find(|place| place.is_of(cell)) {
            *place = Place::default();
            self.taken[number] -= 1;
        }
    }
}

fn set_of(cell: CellIndex) -> usize {
    let mixed = (cell.x as u32).wrapping_mul(0x9e37_79b1) ^ (cell.y as u32).wrapping_mul(0x85eb_ca77);
    (mixed ^ (mixed >> 15)) as usize & (SETS - 1)
}

impl<T: Copy + Default> Default for CellTable<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T> Place<T> {
    fn is_of(&self, cell: CellIndex) -> bool {
        self.touched > 0 && self.cell == cell
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::{BTreeMap, BTreeSet};

    proptest! {
        #[test]
        fn a_table_that_is_not_full_keeps_entries_like_a_map(
            calls in prop::collection::vec((-40..40_i32, -40..40_i32, any::<bool>()), 0..300)
        ) {
            let (mut table, mut model) = (CellTable::<u32>::new(), BTreeMap::new());
            for (now, (x, y, removes)) in (1..).zip(calls) {
                let cell = CellIndex::new(x, y);
                if removes {
                    table.remove(cell);
                    model.remove(&cell);
                } else {
                    let count: &mut u32 = model.entry(cell).or_default();
                    *count += 1;
                    let known = table.touch(cell, now);
                    *known += 1;
                    prop_assert_eq!(known, count);
                }
            }
        }
    }

    #[test]
    fn a_full_table_drops_what_was_touched_longest_ago_and_does_not_grow() {
        let mut table = CellTable::<u8>::new();
        let size = table.places.len();
        let cell = |i: i32| CellIndex::new(i, i / 7);
        for i in 0..200_000 {
            let known = table.touch(cell(i), 1 + i as u32);
            assert_eq!(*known, 0);
            *known = 1;
        }
        assert_eq!(table.places.len(), size);
        let taken =
            |set: usize| table.places[set * WAYS..(set + 1) * WAYS].iter().filter(|place| place.touched > 0);
        assert!((0..SETS).all(|set| taken(set).count() == usize::from(table.taken[set])));
        let mut newest: BTreeMap<usize, BTreeSet<CellIndex>> = BTreeMap::new();
        for cell in (0..200_000).rev().map(cell) {
            let of_set = newest.entry(set_of(cell)).or_default();
            if of_set.len() < WAYS {
                of_set.insert(cell);
            }
        }
        for (set, newest) in newest {
            assert_eq!(taken(set).map(|place| place.cell).collect::<BTreeSet<_>>(), newest);
        }
    }
}
