//! Keeps a copy of the grid that is being built. Takes tiles in; gives one grid of bytes, bounded in size.

use super::Recorded;
use super::foxglove_messages::grid;
use flockslam_evidence::{PackedCell, TILE_CELLS, TILE_SIDE, TileKey};
use flockslam_messages::{Commit, TileMessage};
use std::collections::BTreeMap;

/// Cells of a rectangle that are sent at most; beyond, only its tiles around the middle are.
const CELLS_MAX: usize = 4 << 20;

/// A copy of the grid that scans are matched to, as bytes: nothing of the mapper's memory is held.
#[derive(Debug, Default)]
pub struct LiveGrid {
    tiles: BTreeMap<TileKey, Box<[u8; TILE_CELLS]>>,
    cell_size_m: f64,
}

impl LiveGrid {
    /// Takes in a tile, or that it has left the grid.
    pub fn take(&mut self, tile: &TileMessage) {
        if tile.retired == 1 {
            self.tiles.remove(&tile.key);
            return;
        }
        self.cell_size_m = tile.cell_size_m;
        let bytes = self.tiles.entry(tile.key).or_insert_with(|| Box::new([0; TILE_CELLS]));
        for (byte, cell) in bytes.iter_mut().zip(&tile.tile.cells) {
            *byte = shade(*cell);
        }
    }

    /// The grid as a message, at the time of the scan that was inserted last; `None` while it is empty.
    pub fn message(&self, commit: &Commit) -> Option<Recorded> {
        let (first, last) = self.bounds()?;
        let columns = (last.x - first.x + 1) as usize * TILE_SIDE;
        let rows = (last.y - first.y + 1) as usize * TILE_SIDE;
        let mut cells = vec![0; columns * rows];
        for (key, tile) in &self.tiles {
            if !(first.x..=last.x).contains(&key.x) || !(first.y..=last.y).contains(&key.y) {
                continue;
            }
            let (left, bottom) =
                ((key.x - first.x) as usize * TILE_SIDE, (key.y - first.y) as usize * TILE_SIDE);
            for (row, line) in tile.chunks_exact(TILE_SIDE).enumerate() {
                let at = (bottom + row) * columns + left;
                cells[at..at + TILE_SIDE].copy_from_slice(line);
            }
        }
        let side_m = self.cell_size_m * TILE_SIDE as f64;
        let corner_m = (f64::from(first.x) * side_m, f64::from(first.y) * side_m);
        Some(grid(commit.times.utc_ns, corner_m, self.cell_size_m, columns, &cells))
    }

    /// The tiles at two corners of the rectangle that is sent.
    fn bounds(&self) -> Option<(TileKey, TileKey)> {
        let (x, y) = (|key: &TileKey| key.x, |key: &TileKey| key.y);
        let ends = |of: fn(&TileKey) -> i32| {
            Some((self.tiles.keys().map(of).min()?, self.tiles.keys().map(of).max()?))
        };
        let (mut x, mut y) = (ends(x)?, ends(y)?);
        let tiles_max = CELLS_MAX / TILE_CELLS;
        let length = |(from, to): (i32, i32)| (i64::from(to) - i64::from(from) + 1) as usize;
        while length(x) * length(y) > tiles_max {
            let longer = if length(x) >= length(y) { &mut x } else { &mut y };
            *longer = (longer.0 + 1, longer.1 - 1);
        }
        Some((TileKey { x: x.0, y: y.0 }, TileKey { x: x.1, y: y.1 }))
    }
}

/// 0 for unknown, else 1 (free) … 255 (occupied).
fn shade(cell: PackedCell) -> u8 {
    match cell.masses().occupancy() {
        Some(occupancy) if !cell.is_unknown() => 1 + (254.0 * occupancy.clamp(0.0, 1.0)).round() as u8,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::Cell;
    use serde_json::Value;
    use zerocopy::FromZeros;

    fn tile(x: i32, y: i32, first: PackedCell) -> Box<TileMessage> {
        let mut message = Box::new(TileMessage::new_zeroed());
        (message.key, message.cell_size_m) = (TileKey { x, y }, 0.05);
        message.tile.cells = [PackedCell::UNKNOWN; TILE_CELLS];
        message.tile.cells[0] = first;
        message
    }

    #[test]
    fn tiles_come_together_and_go() {
        let occupied = Cell::from_weights(8.0, 0.0).pack();
        let free = Cell::from_weights(0.0, 8.0).pack();
        let mut grid = LiveGrid::default();
        assert!(grid.message(&Commit::default()).is_none());
        grid.take(&tile(-1, 0, occupied));
        grid.take(&tile(0, 1, free));
        let message = grid.message(&Commit::default()).unwrap();
        let seen: Value = serde_json::from_slice(&message.data).unwrap();
        assert_eq!(seen["column_count"], 128);
        assert!((seen["pose"]["position"]["x"].as_f64().unwrap() + 3.2).abs() < 1e-9);
        let cells = data_encoding::BASE64.decode(seen["data"].as_str().unwrap().as_bytes()).unwrap();
        assert_eq!(cells.len(), 128 * 128);
        assert_eq!((cells[0], cells[64 * 128 + 64]), (255, 1));
        assert_eq!(cells.iter().filter(|cell| **cell > 0).count(), 2);
        let mut gone = tile(-1, 0, occupied);
        gone.retired = 1;
        grid.take(&gone);
        let seen: Value = serde_json::from_slice(&grid.message(&Commit::default()).unwrap().data).unwrap();
        assert_eq!(seen["column_count"], 64);
    }

    #[test]
    fn what_is_sent_is_bounded() {
        let mut grid = LiveGrid::default();
        for x in [-2000, 0, 2000] {
            grid.take(&tile(x, x, PackedCell::UNKNOWN));
        }
        let (first, last) = grid.bounds().unwrap();
        // The tiles around the middle: 31 × 33, at most 1024.
        assert_eq!((first, last), (TileKey { x: -15, y: -16 }, TileKey { x: 15, y: 16 }));
        let message = grid.message(&Commit::default()).unwrap();
        // Base64 takes four bytes for three cells.
        assert!(message.data.len() < 31 * 33 * TILE_CELLS * 4 / 3 + 2000, "{}", message.data.len());
    }
}
