//! An index from tile keys to content, dense over the bounds of the keys, with a limit on its size.

use crate::TileKey;

/// Entries that a directory may span: 2048 × 2048 tiles, 6 × 6 km with cells of 5 cm.
const ENTRIES_MAX: usize = 1 << 22;
/// Empty tiles added on every side when a directory grows, so that it grows rarely.
const MARGIN: i64 = 8;

/// A key is so far from the others that the directory would not fit into memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("tile ({}, {}) is too far from the rest of the map", .0.x, .0.y)]
pub struct TooFar(pub TileKey);

/// Content of each tile of a bounded part of the plane: a dense array over the bounds of the keys set so far.
///
/// Reading is two comparisons and one index; it grows by copying the entries, never their content.
#[derive(Clone, Debug)]
pub struct TileDirectory<T> {
    origin: TileKey,
    width: usize,
    height: usize,
    entries: Vec<Option<T>>,
    count: usize,
}

impl<T> Default for TileDirectory<T> {
    fn default() -> Self {
        Self { origin: TileKey::default(), width: 0, height: 0, entries: Vec::new(), count: 0 }
    }
}

impl<T> TileDirectory<T> {
    /// Number of tiles present.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether no tile is present.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Content of a tile.
    #[inline]
    pub fn get(&self, key: TileKey) -> Option<&T> {
        self.entries[self.place(key)?].as_ref()
    }

    /// Content of a tile, to change it.
    #[inline]
    pub fn get_mut(&mut self, key: TileKey) -> Option<&mut T> {
        let place = self.place(key)?;
        self.entries[place].as_mut()
    }

    /// Replaces the content of the tile; gives the former content.
    ///
    /// # Errors
    /// When the bounds of all keys would get too large.
    pub fn set(&mut self, key: TileKey, content: T) -> Result<Option<T>, TooFar> {
        let place = match self.place(key) {
            Some(place) => place,
            None => {
                self.grow(key)?;
                self.place(key).expect("a grown directory holds the key")
            }
        };
        let before = self.entries[place].replace(content);
        self.count += usize::from(before.is_none());
        Ok(before)
    }

    /// Takes the content of a tile out.
    pub fn remove(&mut self, key: TileKey) -> Option<T> {
        let place = self.place(key)?;
        let content = self.entries[place].take();
        self.count -= usize::from(content.is_some());
        content
    }

    /// All tiles present, row by row.
    pub fn iter(&self) -> impl Iterator<Item = (TileKey, &T)> {
        let (origin, width) = (self.origin, self.width);
        self.entries.iter().enumerate().filter_map(move |(place, content)| {
            let key = TileKey { x: origin.x + (place % width) as i32, y: origin.y + (place / width) as i32 };
            content.as_ref().map(|content| (key, content))
        })
    }

    #[inline]
    fn place(&self, key: TileKey) -> Option<usize> {
        // As unsigned numbers, indices left of the origin are huge.
        let (x, y) = (key.x.wrapping_sub(self.origin.x) as u32, key.y.wrapping_sub(self.origin.y) as u32);
        ((x as usize) < self.width && (y as usize) < self.height)
            .then(|| y as usize * self.width + x as usize)
    }

    fn grow(&mut self, key: TileKey) -> Result<(), TooFar> {
        let (x, y) = (i64::from(key.x), i64::from(key.y));
        let (mut x0, mut y0) = (x - MARGIN, y - MARGIN);
        let (mut x1, mut y1) = (x + MARGIN + 1, y + MARGIN + 1);
        if self.width > 0 {
            let (left, bottom) = (i64::from(self.origin.x), i64::from(self.origin.y));
            (x0, y0) = (x0.min(left), y0.min(bottom));
            (x1, y1) = (x1.max(left + self.width as i64), y1.max(bottom + self.height as i64));
        }
        let (width, height) = ((x1 - x0) as usize, (y1 - y0) as usize);
        let origin = (i32::try_from(x0), i32::try_from(y0), i32::try_from(x1), i32::try_from(y1));
        let (Ok(x0), Ok(y0), Ok(_), Ok(_)) = origin else { return Err(TooFar(key)) };
        if width.checked_mul(height).is_none_or(|entries| entries > ENTRIES_MAX) {
            return Err(TooFar(key));
        }
        let mut entries: Vec<Option<T>> = std::iter::repeat_with(|| None).take(width * height).collect();
        let (dx, dy) = ((self.origin.x - x0) as usize, (self.origin.y - y0) as usize);
        for (place, content) in self.entries.drain(..).enumerate() {
            entries[(place / self.width + dy) * width + place % self.width + dx] = content;
        }
        *self = Self { origin: TileKey { x: x0, y: y0 }, width, height, entries, count: self.count };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn behaves_like_a_map(edits in proptest::collection::vec((-60i32..60, -60i32..60, any::<bool>()), 0..80)) {
            let mut directory = TileDirectory::default();
            let mut model = BTreeMap::new();
            for (number, (x, y, put)) in edits.into_iter().enumerate() {
                let key = TileKey { x, y };
                if put {
                    prop_assert_eq!(directory.set(key, number).unwrap(), model.insert(key, number));
                } else {
                    prop_assert_eq!(directory.remove(key), model.remove(&key));
                }
            }
            prop_assert_eq!(directory.len(), model.len());
            let mut found: Vec<_> = directory.iter().map(|(key, number)| (key, *number)).collect();
            found.sort_unstable();
            prop_assert_eq!(found, model.into_iter().collect::<Vec<_>>());
        }
    }

    #[test]
    fn far_keys_are_refused_and_change_nothing() {
        let mut directory = TileDirectory::default();
        directory.set(TileKey { x: 0, y: 0 }, 'a').unwrap();
        for far in [
            TileKey { x: i32::MAX, y: 0 },
            TileKey { x: i32::MIN, y: i32::MIN },
            TileKey { x: 9000, y: 9000 },
        ] {
            assert_eq!(directory.set(far, 'b'), Err(TooFar(far)));
            assert_eq!(directory.get(far), None);
        }
        assert_eq!((directory.len(), directory.get(TileKey { x: 0, y: 0 })), (1, Some(&'a')));
    }
}
