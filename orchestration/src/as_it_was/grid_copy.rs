//! A copy of the grid as a reader of it had it: it takes the changes of commits in their order.

use flockslam_evidence::{Tile, TileGrid, TileKey};
use std::collections::VecDeque;
use std::sync::Arc;

/// New content of tiles; `None`: the tile has left the grid.
pub type TileChanges = Vec<(TileKey, Option<Arc<Tile>>)>;

/// The changes of each commit, by its place, as long as a reader lacks them.
#[derive(Default)]
pub struct CommitChanges {
    first: usize,
    changes: VecDeque<TileChanges>,
}

impl CommitChanges {
    /// Adds those of the next commit.
    pub fn push(&mut self, changes: TileChanges) {
        self.changes.push_back(changes);
    }

    /// Drops those of commits before this place.
    pub fn drop_before(&mut self, place: usize) {
        while self.first < place && self.changes.pop_front().is_some() {
            self.first += 1;
        }
    }

    fn of(&self, place: usize) -> Option<&TileChanges> {
        self.changes.get(place.checked_sub(self.first)?)
    }
}

/// The grid of one process.
pub struct GridCopy {
    grid: TileGrid<Arc<Tile>>,
    /// The next commit that it takes, once it has taken one.
    next: Option<usize>,
}

impl GridCopy {
    /// An empty grid with cells of this side.
    pub fn new(cell_size_m: f64) -> Self {
        Self { grid: TileGrid::new(cell_size_m), next: None }
    }

    /// Takes all commits up to the one at place `to`; a new reader begins with that at place `first`.
    pub fn advance(&mut self, changes: &CommitChanges, first: usize, to: usize) {
        let next = self.next.unwrap_or(first);
        for (key, tile) in (next..=to).filter_map(|place| changes.of(place)).flatten() {
            match tile {
                // The live reader leaves out what is out of reach, too.
                Some(tile) => drop(self.grid.set(*key, Arc::clone(tile))),
                None => drop(self.grid.remove(*key)),
            }
        }
        self.next = Some(next.max(to + 1));
    }

    /// The grid.
    pub fn grid(&self) -> &TileGrid<Arc<Tile>> {
        &self.grid
    }

    /// The place of the next commit that it takes; `None` before the first.
    pub fn next(&self) -> Option<usize> {
        self.next
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_reader_has_only_later_changes() {
        let key = |x| TileKey { x, y: 0 };
        let tile = || Some(Arc::from(Tile::unknown(0)));
        let mut changes = CommitChanges::default();
        changes.push(vec![(key(0), tile()), (key(1), tile())]);
        changes.push(vec![(key(2), tile()), (key(0), None)]);
        changes.push(vec![(key(3), tile())]);
        let (mut whole, mut late) = (GridCopy::new(0.05), GridCopy::new(0.05));
        whole.advance(&changes, 0, 0);
        assert_eq!((whole.grid().len(), whole.next()), (2, Some(1)));
        whole.advance(&changes, 0, 1);
        changes.drop_before(1);
        late.advance(&changes, 1, 2);
        whole.advance(&changes, 0, 2);
        assert_eq!((whole.grid().len(), late.grid().len()), (3, 2));
        assert!(late.grid().tile(key(1)).is_none() && whole.grid().tile(key(1)).is_some());
    }
}
