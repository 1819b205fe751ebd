//! The tiles of one grid, encoded, each with the version of its last change.

use crate::shade::Shades;
use crate::tile_code::encode_tile;
use flockslam_evidence::TileKey;
use std::collections::BTreeMap;

/// Tiles of one lattice as browsers are given them: encoded, each with the version at which it became as it is. What is new since any
/// version can be sent, the newest state of each tile once.
#[derive(Debug, Default)]
pub struct Layer {
    tiles: BTreeMap<TileKey, (u64, Vec<u8>)>,
    by_version: BTreeMap<u64, TileKey>,
    version: u64,
}

impl Layer {
    /// Sets a tile; one that looks as before is not new.
    pub fn set(&mut self, key: TileKey, shades: &Shades) {
        self.put(key, encode_tile(shades));
    }

    /// Removes a tile. The removal stays recorded, for clients that have it.
    pub fn remove(&mut self, key: TileKey) {
        if self.tiles.contains_key(&key) {
            self.put(key, Vec::new());
        }
    }

    fn put(&mut self, key: TileKey, code: Vec<u8>) {
        if let Some((version, present)) = self.tiles.get(&key) {
            if *present == code {
                return;
            }
            self.by_version.remove(version);
        }
        self.version += 1;
        self.by_version.insert(self.version, key);
        self.tiles.insert(key, (self.version, code));
    }

    /// Tiles that are new since `version`, the longest unchanged first, with their versions; an empty code means that the tile is gone.
    pub fn since(&self, version: u64) -> impl Iterator<Item = (u64, TileKey, &[u8])> {
        self.by_version
            .range(version + 1..)
            .map(|(version, key)| (*version, *key, self.tiles[key].1.as_slice()))
    }

    /// Tiles that there are.
    pub fn count(&self) -> usize {
        self.tiles.values().filter(|(_, code)| !code.is_empty()).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::TILE_CELLS;

    #[test]
    fn each_tile_is_sent_once_in_its_newest_state() {
        let key = |x| TileKey { x, y: 0 };
        let mut layer = Layer::default();
        for shade in 1..5 {
            (0..3).for_each(|x| layer.set(key(x), &[shade; TILE_CELLS]));
        }
        let all: Vec<_> = layer.since(0).map(|(_, key, code)| (key.x, code.to_vec())).collect();
        assert_eq!(all.iter().map(|(x, _)| *x).collect::<Vec<_>>(), [0, 1, 2]);
        assert!(all.iter().all(|(_, code)| *code == encode_tile(&[4; TILE_CELLS])));
        let seen = layer.since(0).map(|(version, ..)| version).max().unwrap();
        layer.set(key(1), &[4; TILE_CELLS]);
        assert_eq!(layer.since(seen).count(), 0, "it looks as before");
        layer.remove(key(2));
        layer.remove(key(7));
        let gone: Vec<_> = layer.since(seen).map(|(_, key, code)| (key.x, code.len())).collect();
        assert_eq!((gone, layer.count()), (vec![(2, 0)], 2));
    }
}
