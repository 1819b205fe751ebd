//! A closed submap of the window: needed to withdraw its evidence once it leaves the window.

use flockslam_evidence::{
    BlockTile, Cell, CellIndex, PackedCell, Submap, SubmapTile, TILE_CELLS, TILE_SIDE, TileKey,
};

/// A closed submap in little memory: most of its cells are unknown or free.
#[derive(Debug)]
pub(crate) struct ClosedSubmap {
    /// All of it but its tiles.
    head: Submap,
    last_ns: i64,
    /// Sorted by key.
    tiles: Vec<ClosedTile>,
}

/// A tile of a closed submap.
#[derive(Debug)]
pub(crate) struct ClosedTile {
    key: TileKey,
    cells: BlockTile,
    /// As in [`SubmapTile`].
    cleared: [u64; TILE_SIDE],
}

impl ClosedSubmap {
    /// `last_ns` is the sensor stamp of its last scan, nanoseconds; an unknown one is in the future.
    pub(crate) fn new(submap: &Submap, last_ns: i64) -> Self {
        let Submap { number, trajectory, insertions, first, last, odom_from_submap, cell_size_m, tiles } =
            submap;
        let head = Submap {
            number: *number,
            trajectory: *trajectory,
            insertions: *insertions,
            first: *first,
            last: *last,
            odom_from_submap: *odom_from_submap,
            cell_size_m: *cell_size_m,
            tiles: Vec::new(),
        };
        Self { head, last_ns, tiles: tiles.iter().map(ClosedTile::new).collect() }
    }

    pub(crate) fn number(&self) -> u32 {
        self.head.number
    }

    /// Sensor stamp of its last scan, nanoseconds.
    pub(crate) fn last_ns(&self) -> i64 {
        self.last_ns
    }

    /// Sequence of its first scan.
    pub(crate) fn first(&self) -> u64 {
        self.head.first
    }

    /// Masks a cell.
    pub(crate) fn clear(&mut self, cell: CellIndex) {
        if let Ok(place) = self.tiles.binary_search_by_key(&cell.tile(), |tile| tile.key) {
            let offset = cell.offset();
            self.tiles[place].cleared[offset / TILE_SIDE] |= 1 << (offset % TILE_SIDE);
        }
    }

    /// Whether a cell was masked.
    pub(crate) fn has_cleared(&self) -> bool {
        self.tiles.iter().any(|tile| tile.cleared.iter().any(|row| *row != 0))
    }

    /// Its tiles, one after the other.
    pub(crate) fn tiles(&self) -> &[ClosedTile] {
        &self.tiles
    }

    /// The submap as it was closed, with the cells that have been masked since.
    pub(crate) fn submap(&self) -> Submap {
        Submap { tiles: self.tiles.iter().map(ClosedTile::tile).collect(), ..self.head.clone() }
    }
}

impl ClosedTile {
    fn new(tile: &SubmapTile) -> Self {
        Self { key: tile.key, cells: BlockTile::of(&tile.cells), cleared: tile.cleared }
    }

    pub(crate) fn key(&self) -> TileKey {
        self.key
    }

    /// The cells with evidence that are not masked, and their offsets.
    pub(crate) fn evidence(&self) -> impl Iterator<Item = (usize, Cell)> {
        let is_masked = |offset: usize| self.cleared[offset / TILE_SIDE] >> (offset % TILE_SIDE) & 1 == 1;
        self.cells.known().filter(move |(offset, _)| !is_masked(*offset))
    }

    fn tile(&self) -> SubmapTile {
        let mut cells = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
        self.cells.known().for_each(|(offset, cell)| cells[offset] = cell.pack());
        SubmapTile { cleared: self.cleared, ..SubmapTile::new(self.key, cells) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_submap_comes_back_as_it_was_with_the_cells_that_were_masked() {
        let cell = |offset: usize| match offset % 7 {
            0 => PackedCell { occupied: offset as u16, free: u16::MAX },
            1..4 => PackedCell { occupied: 0, free: offset as u16 },
            _ => PackedCell::UNKNOWN,
        };
        let tile = |x| SubmapTile::new(TileKey { x, y: -1 }, Box::new(std::array::from_fn(cell)));
        let mut expected = Submap {
            number: 3,
            trajectory: 2,
            insertions: 9,
            first: 5,
            last: 77,
            cell_size_m: 0.05,
            tiles: (-1..2).map(tile).collect(),
            ..Submap::default()
        };
        let mut closed = ClosedSubmap::new(&expected, 5);
        assert_eq!((closed.submap(), closed.has_cleared()), (expected.clone(), false));
        for cell in [CellIndex::new(3, -5), CellIndex::new(-1, -64), CellIndex::new(900, 0)] {
            expected.clear(cell);
            closed.clear(cell);
        }
        assert_eq!((closed.submap(), closed.has_cleared()), (expected, true));
    }
}
