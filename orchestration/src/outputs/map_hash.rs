//! A hash of a fused map: equal for maps that are equal to the bit.

use flockslam_evidence::Cell;
use flockslam_results::{MapShape, StoredMap};

/// Names a fused map: blake3 over its place, its size and every cell, hexadecimal.
pub fn map_hash(map: &StoredMap) -> String {
    let mut hasher = MapHasher::new(&map.shape());
    map.for_each_row(|row| hasher.push_row(row));
    hasher.finish()
}

/// As [`map_hash`], for a map that is read row by row.
pub struct MapHasher {
    hasher: blake3::Hasher,
    bytes: Vec<u8>,
}

impl MapHasher {
    /// Before the first row.
    pub fn new(shape: &MapShape) -> Self {
        let mut hasher = blake3::Hasher::new();
        for number in [shape.width as u64, shape.height as u64] {
            hasher.update(&number.to_le_bytes());
        }
        for number in [shape.cell_size_m, shape.origin.x_m, shape.origin.y_m] {
            hasher.update(&number.to_bits().to_le_bytes());
        }
        Self { hasher, bytes: Vec::with_capacity(size_of::<Cell>() * shape.width) }
    }

    /// Takes the next row in.
    pub fn push_row(&mut self, row: &[Cell]) {
        self.bytes.clear();
        for cell in row {
            self.bytes.extend_from_slice(&cell.occupied.to_le_bytes());
            self.bytes.extend_from_slice(&cell.free.to_le_bytes());
        }
        self.hasher.update(&self.bytes);
    }

    /// The hash after the last row.
    pub fn finish(self) -> String {
        self.hasher.finalize().to_hex().to_string()
    }
}
