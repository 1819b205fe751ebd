//! A cache of the search fields of segments: the fields used last are kept, up to a number.

use flockslam_registration::cloud::PooledField;

/// Fields kept ready for searching; each takes one to two hundred kilobytes.
pub const FIELDS_MAX: usize = 48;

/// The fields of the segments searched last, made again when they are wanted after having been dropped.
pub struct FieldCache {
    /// (segment, use that was its last, field).
    held: Vec<(u64, u64, PooledField)>,
    uses: u64,
    most: usize,
}

impl FieldCache {
    /// A cache that holds so many fields.
    pub fn new(most: usize) -> Self {
        Self { held: Vec::new(), uses: 0, most }
    }

    /// The field of the segment whose anchor has this sequence, made by `make` when it is not held.
    pub fn get(&mut self, segment: u64, make: impl FnOnce() -> PooledField) -> &PooledField {
        self.uses += 1;
        let slot = match self.held.iter().position(|held| held.0 == segment) {
            Some(slot) => slot,
            None => {
                self.make_room();
                self.held.push((segment, 0, make()));
                self.held.len() - 1
            }
        };
        self.held[slot].1 = self.uses;
        &self.held[slot].2
    }

    fn make_room(&mut self) {
        if self.held.len() == self.most {
            let oldest =
                (0..self.most).min_by_key(|&slot| self.held[slot].1).expect("the cache holds fields");
            self.held.swap_remove(oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drops_what_was_used_longest_ago() {
        let mut cache = FieldCache::new(FIELDS_MAX);
        let mut made = Vec::new();
        for segment in (0..FIELDS_MAX as u64 + 3).flat_map(|k| [0, k]).chain([0, 1]) {
            cache.get(segment, || {
                made.push(segment);
                PooledField::new(&[(0.0, 0.0)])
            });
        }
        let mut expected: Vec<u64> = (0..FIELDS_MAX as u64 + 3).collect();
        expected.push(1);
        assert_eq!(made, expected);
        assert_eq!(cache.held.len(), FIELDS_MAX);
    }
}
