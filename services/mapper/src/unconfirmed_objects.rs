//! Objects in known free space until they are confirmed: takes sightings of cells, gives the number of confirmations of each.

use flockslam_evidence::{CellIndex, CellTable};

/// Two sightings count when their scans are at least so far apart, nanoseconds: a walking person has gone on by then.
const APART_NS: u64 = 300_000_000;
/// A sighting that was not repeated for so long does not count any more, nanoseconds.
const DROPPED_AFTER_NS: u64 = 5_000_000_000;

/// Sightings in known free space. A person who walks by is seen there once or twice; an object that stays is seen again,
/// and then enters the map.
#[derive(Clone, Debug, Default)]
pub(crate) struct UnconfirmedObjects {
    places: CellTable<Sightings>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sightings {
    count: u8,
    last_ns: i64,
}

impl UnconfirmedObjects {
    /// Counts a sighting in a cell by scan number `scan` with this sensor stamp; gives how often it was seen there, scans well
    /// apart.
    pub(crate) fn seen(&mut self, cell: CellIndex, scan: u32, stamp_ns: i64) -> u8 {
        // A surface is not seen in exactly the same cell every time.
        let place = CellIndex::new(cell.x >> 1, cell.y >> 1);
        let sightings = self.places.touch(place, scan);
        let since_ns = stamp_ns.abs_diff(sightings.last_ns);
        if sightings.count == 0 || since_ns > DROPPED_AFTER_NS {
            *sightings = Sightings { count: 1, last_ns: stamp_ns };
        } else if since_ns >= APART_NS {
            *sightings = Sightings { count: sightings.count.saturating_add(1), last_ns: stamp_ns };
        }
        sightings.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: i64 = 1_000_000_000;

    #[test]
    fn sightings_count_when_they_are_apart_and_not_for_ever() {
        let mut unconfirmed_objects = UnconfirmedObjects::default();
        let cell = CellIndex::new(-3, 8);
        let mut seen =
            |x: i32, stamp_ns: i64| unconfirmed_objects.seen(CellIndex::new(x, cell.y), 1, stamp_ns);
        assert_eq!((seen(-3, SECOND_NS), seen(-4, SECOND_NS), seen(-5, SECOND_NS)), (1, 1, 1));
        assert_eq!((seen(-3, SECOND_NS + 200_000_000), seen(-3, SECOND_NS + 400_000_000)), (1, 2));
        assert_eq!((seen(-4, 2 * SECOND_NS), seen(-4, 8 * SECOND_NS)), (3, 1));
    }
}
