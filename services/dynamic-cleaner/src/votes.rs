use flockslam_evidence::CellIndex;
use flockslam_geometry::Pose;

/// Places in a set of the table.
const WAYS: usize = 4;
/// Sets of the table, a power of two.
const SETS: usize = 1 << 13;

/// Counts for cells how many scans from different places have looked through them.
///
/// A table of fixed size in sets of four places. When a set is full the vote that was renewed longest ago gives way, so
/// memory stays bounded and what is forgotten does not depend on anything but the scans.
#[derive(Clone, Debug)]
pub(crate) struct Votes {
    entries: Vec<Entry>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    cell: CellIndex,
    /// 0: the place is free.
    count: u8,
    /// Number of the scan that voted last.
    scan: u32,
    x_m: f32,
    y_m: f32,
    heading_rad: f32,
}

/// How far apart the lidar must be for two votes to count.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Baseline {
    pub distance_m: f64,
    pub turn_rad: f64,
}

impl Votes {
    pub fn new() -> Self {
        Self { entries: vec![Entry::default(); SETS * WAYS] }
    }

    /// Adds a vote for a cell, given from `laser` in scan number `scan`, unless the last one came from nearly the same
    /// place; gives the number of votes.
    pub fn add(&mut self, cell: CellIndex, laser: Pose, scan: u32, baseline: Baseline) -> u8 {
        let set = self.set_of(cell);
        let entry = match set.iter().position(|entry| entry.count > 0 && entry.cell == cell) {
            Some(place) => &mut set[place],
            None => {
                let oldest = set.iter_mut().min_by_key(|entry| if entry.count == 0 { 0 } else { entry.scan });
                let entry = oldest.expect("a set has places");
                *entry = Entry { cell, ..Entry::default() };
                entry
            }
        };
        let last = Pose::new(f64::from(entry.x_m), f64::from(entry.y_m), f64::from(entry.heading_rad));
        let moved =
            laser.distance_m(last) >= baseline.distance_m || laser.turn_rad(last) >= baseline.turn_rad;
        if entry.count == 0 || moved {
            entry.count = entry.count.saturating_add(1);
            (entry.x_m, entry.y_m) = (laser.x_m as f32, laser.y_m as f32);
            entry.heading_rad = laser.heading_rad as f32;
            entry.scan = scan;
        }
        entry.count
    }

    /// Forgets all votes for a cell.
    pub fn forget(&mut self, cell: CellIndex) {
        let entry = self.set_of(cell).iter_mut().find(|entry| entry.count > 0 && entry.cell == cell);
        if let Some(entry) = entry {
            entry.count = 0;
        }
    }

    fn set_of(&mut self, cell: CellIndex) -> &mut [Entry] {
        let mixed = (cell.x as u32).wrapping_mul(0x9e37_79b1) ^ (cell.y as u32).wrapping_mul(0x85eb_ca77);
        let set = (mixed ^ (mixed >> 15)) as usize & (SETS - 1);
        &mut self.entries[set * WAYS..(set + 1) * WAYS]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    const BASELINE: Baseline = Baseline { distance_m: 0.1, turn_rad: 0.2 };

    #[test]
    fn votes_from_one_place_count_once_and_support_takes_them_back() {
        let (mut votes, cell) = (Votes::new(), CellIndex::new(3, -4));
        let at = |x_m, heading_rad| Pose::new(x_m, 0.0, heading_rad);
        assert_eq!(votes.add(cell, at(0.0, 0.0), 1, BASELINE), 1);
        assert_eq!(votes.add(cell, at(0.05, 0.1), 2, BASELINE), 1);
        assert_eq!(votes.add(cell, at(0.12, 0.1), 3, BASELINE), 2);
        assert_eq!(votes.add(cell, at(0.12, 0.4), 4, BASELINE), 3);
        votes.forget(cell);
        assert_eq!(votes.add(cell, at(0.12, 0.4), 5, BASELINE), 1);
    }

    proptest! {
        #[test]
        fn a_table_that_is_not_full_counts_like_a_map(cells in prop::collection::vec((-40..40_i32, -40..40_i32), 0..300)) {
            let (mut votes, mut model) = (Votes::new(), BTreeMap::new());
            for (scan, (x, y)) in (1..).zip(cells) {
                let count: &mut u8 = model.entry((x, y)).or_default();
                *count += 1;
                let laser = Pose::new(f64::from(scan), 0.0, 0.0);
                prop_assert_eq!(votes.add(CellIndex::new(x, y), laser, scan, BASELINE), *count);
            }
        }
    }

    #[test]
    fn a_full_table_forgets_but_does_not_grow() {
        let mut votes = Votes::new();
        let size = votes.entries.len();
        for i in 0..200_000 {
            assert_eq!(votes.add(CellIndex::new(i, i / 7), Pose::IDENTITY, 1 + i as u32, BASELINE), 1);
        }
        assert_eq!(votes.entries.len(), size);
    }
}
