//! Tests of the stored form of submaps.

use super::*;
use proptest::prelude::*;

/// A submap with a few cells of evidence and some of them cleared.
pub(crate) fn submap() -> impl Strategy<Value = Submap> {
    let cell = (-90i32..90, -90i32..90, 0u16..9000, 1u16..9000, any::<bool>());
    (proptest::collection::vec(cell, 0..60), -3.0..3.0f64, -2.0..2.0f64).prop_map(|(cells, heading, x)| {
        let mut tiles = std::collections::BTreeMap::new();
        for (x, y, occupied, free, cleared) in cells {
            let index = crate::CellIndex::new(x, y);
            let empty = || SubmapTile::new(index.tile(), Box::new([PackedCell::UNKNOWN; TILE_CELLS]));
            let tile = tiles.entry(index.tile()).or_insert_with(empty);
            tile.cells[index.offset()] = PackedCell { occupied, free };
            if cleared {
                tile.clear(index.offset());
            }
        }
        let odom_from_submap = Pose::new(x, 0.5, heading);
        let tiles = tiles.into_values().collect();
        Submap {
            number: 3,
            trajectory: 0,
            insertions: 7,
            first: 40,
            last: 61,
            odom_from_submap,
            cell_size_m: 0.05,
            tiles,
        }
    })
}

proptest! {
    #[test]
    fn what_was_written_is_read(submap in submap()) {
        let bytes = submap.encode();
        let read = Submap::decode(&bytes).unwrap();
        prop_assert_eq!(read.encode(), bytes);
        prop_assert_eq!(read, submap.quantised());
    }

    #[test]
    fn masks_are_written_anew_without_the_cells(
        submap in submap(), more in proptest::collection::vec((-90i32..90, -90i32..90), 0..20), unmasks in any::<bool>()
    ) {
        let stored = submap.encode();
        let mut changed = Submap::decode(&stored).unwrap();
        if unmasks {
            changed.tiles.iter_mut().for_each(|tile| tile.cleared = [0; TILE_SIDE]);
        }
        let more: Vec<CellIndex> = more.into_iter().map(|(x, y)| CellIndex::new(x, y)).collect();
        let before = changed.encode();
        more.iter().for_each(|cell| {
            changed.clear(*cell);
        });
        prop_assert_eq!(changed.encode_cleared(&stored), Ok(changed.encode()));
        prop_assert_eq!(with_masked(&before, &more), Ok(changed.encode()));
    }

    #[test]
    fn the_outline_is_read_without_the_cells(submap in submap()) {
        let outline = SubmapOutline::decode(&submap.encode()).unwrap();
        prop_assert_eq!(&outline, &SubmapOutline::of(&submap));
        for (key, blocks) in outline.blocks {
            let tile = submap.tile(key).unwrap();
            for (offset, cell) in tile.cells.iter().enumerate() {
                let block = offset / TILE_SIDE / 8 * 8 + offset % TILE_SIDE / 8;
                prop_assert!(cell.is_unknown() || blocks >> block & 1 == 1);
            }
        }
    }

    #[test]
    fn damaged_bytes_are_refused(
        submap in submap(), place in any::<prop::sample::Index>(), flip in 1u8.., cut in any::<prop::sample::Index>()
    ) {
        let mut bytes = submap.encode();
        prop_assert!(Submap::decode(&bytes[..cut.index(bytes.len())]).is_err());
        let place = place.index(bytes.len());
        bytes[place] ^= flip;
        prop_assert!(Submap::decode(&bytes).is_err());
    }

    #[test]
    fn forged_bytes_are_refused_or_a_submap_but_never_a_crash(
        submap in submap(), place in any::<prop::sample::Index>(), flip in 1u8.., version in VERSION_BEFORE..=VERSION
    ) {
        let mut bytes = submap.encode();
        bytes[VERSION_AT] = version;
        let place = CHECKED_FROM + place.index(bytes.len() - CHECKED_FROM);
        bytes[place] ^= flip;
        if let Ok(other) = Submap::decode(&signed(bytes)) {
            prop_assert_eq!(Submap::decode(&other.encode()), Ok(other));
        }
    }

    #[test]
    fn keys_come_back(keys in proptest::collection::btree_set((any::<i32>(), any::<i32>()), 0..20)) {
        let cells = Box::new([PackedCell { occupied: 0, free: 3 }; TILE_CELLS]);
        let tiles = keys.into_iter().map(|(x, y)| SubmapTile::new(TileKey { x, y }, cells.clone()));
        let submap = Submap { tiles: tiles.collect(), ..empty() };
        prop_assert_eq!(Submap::decode(&submap.encode()), Ok(submap));
    }
}

fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
    let checksum = crc32fast::hash(&bytes[CHECKED_FROM..]);
    bytes[CHECKED_FROM - 4..CHECKED_FROM].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

fn empty() -> Submap {
    Submap { cell_size_m: 0.05, ..Submap::default() }
}

#[test]
fn sizes_are_checked_before_allocation() {
    let mut bytes = empty().encode();
    let count = bytes.len() - 10;
    bytes[count..count + 4].fill(0xff);
    let mut bytes = signed(bytes);
    assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::TooManyTiles(u32::MAX)));
    bytes[9] ^= 1;
    assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::Damaged));
    bytes[4] = 9;
    assert_eq!(Submap::decode(&bytes), Err(SubmapBytesError::Version(9)));
    assert_eq!(Submap::decode(b"PNG"), Err(SubmapBytesError::Truncated));
    let long = [empty().encode(), vec![0; 8]].concat();
    assert_eq!(Submap::decode(&signed(long)), Err(SubmapBytesError::Trailing(3)));
}
