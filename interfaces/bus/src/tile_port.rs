//! Ports for tiles: one sender uses several publishers, so that readers can hold a sample of each live tile.

use crate::{Bus, BusError, Publisher, Sample};
use flockslam_evidence::{Tile, TileKey};
use flockslam_messages::TileMessage;
use std::ops::Deref;

/// Publishers among which the tiles of one sender are shared out. A reader holds a sample of every live tile, and iceoryx2 lays out
/// 3.6 kB in each reader for every sample that may be held of *one* publisher: of sixteen, each has to carry a sixteenth.
pub(crate) const LANES: usize = 16;

/// Sends tiles. Versions of the same tile arrive in the order in which they were sent, those of different tiles in any order.
pub struct TilePublisher {
    lanes: Vec<Publisher<TileMessage>>,
}

impl TilePublisher {
    /// Opens the topic of tiles for sending.
    ///
    /// # Errors
    /// As [`Bus::publisher`].
    pub fn open(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self { lanes: (0..LANES).map(|_| bus.publisher()).collect::<Result<_, _>>()? })
    }

    /// Lends zeroed memory with the tile's key in it, lets `fill` write the rest there, and sends it.
    ///
    /// # Errors
    /// When no memory is free or a connection is broken.
    pub fn send_with(&self, key: TileKey, fill: impl FnOnce(&mut TileMessage)) -> Result<(), BusError> {
        self.lanes[lane(key)].send_with(|message| {
            message.key = key;
            fill(message);
        })
    }

    /// Connects to readers that came since the last message.
    pub fn refresh(&self) {
        self.lanes.iter().for_each(Publisher::refresh);
    }
}

/// Tiles along a row or a column, or of a hall, are shared out evenly; a corridor along a diagonal uses half of the lanes.
fn lane(key: TileKey) -> usize {
    (i64::from(key.x) + 5 * i64::from(key.y)).rem_euclid(LANES as i64) as usize
}

/// A tile held in the mapper's memory: the newest sample of it that a reader has.
pub struct TileHandle(Sample<TileMessage>);

impl TileHandle {
    /// Holds on to a received tile.
    pub fn new(sample: Sample<TileMessage>) -> Self {
        Self(sample)
    }

    /// The message around the tile.
    pub fn message(&self) -> &TileMessage {
        &self.0
    }
}

impl Deref for TileHandle {
    type Target = Tile;

    #[inline]
    fn deref(&self) -> &Tile {
        &self.0.tile
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corridors_and_halls_are_spread_evenly() {
        let most = |keys: &mut dyn Iterator<Item = (i32, i32)>| {
            let mut count = [0; LANES];
            keys.for_each(|(x, y)| count[lane(TileKey { x, y })] += 1);
            count.into_iter().max().unwrap()
        };
        assert_eq!(most(&mut (-40..40).map(|x| (x, 5))), 5);
        assert_eq!(most(&mut (-40..40).map(|y| (5, y))), 5);
        assert_eq!(most(&mut (-40..40).flat_map(|x| [(x, x), (x + 1, x)])), 10);
        assert_eq!(most(&mut (-40..40).flat_map(|x| [(x, -x), (x + 1, -x)])), 20);
        assert_eq!(most(&mut (-8..8).flat_map(|y| (-8..8).map(move |x| (x, y)))), 16);
    }
}
