//! A hash of a fused map: equal for maps that are equal to the bit.

use flockslam_results::StoredMap;

/// Names a fused map: blake3 over its place, its size and every cell, hexadecimal.
pub fn map_hash(map: &StoredMap) -> String {
    let mut hasher = blake3::Hasher::new();
    for number in [map.width as u64, map.height as u64] {
        hasher.update(&number.to_le_bytes());
    }
    for number in [map.cell_size_m, map.origin.x_m, map.origin.y_m] {
        hasher.update(&number.to_bits().to_le_bytes());
    }
    for cell in &map.cells {
        hasher.update(&cell.occupied.to_le_bytes());
        hasher.update(&cell.free.to_le_bytes());
    }
    hasher.finalize().to_hex().to_string()
}
