//! How the tiles of a map are divided among several mappers.

use flockslam_evidence::TileKey;

/// The tiles of one of several mappers. Neighbours along rows and columns belong to different mappers, so that all have
/// about the same work wherever the robot is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileShare {
    part: u32,
    parts: u32,
}

impl TileShare {
    /// All tiles.
    pub const ALL: Self = Self { part: 0, parts: 1 };

    /// Share number `part` (from 0) of `parts`.
    pub fn new(part: u32, parts: u32) -> Self {
        assert!(part < parts, "a share is one of all");
        Self { part, parts }
    }

    /// Whether the tile belongs to it. Every tile belongs to exactly one share.
    #[inline]
    pub fn has(self, key: TileKey) -> bool {
        self.parts == 1
            || (i64::from(key.x) + i64::from(key.y)).rem_euclid(i64::from(self.parts)) == i64::from(self.part)
    }
}
