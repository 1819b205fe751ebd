//! Submaps: immutable evidence by tiles, a reference pose, and a mask of cells that were found stale afterwards.

use crate::{CellIndex, PackedCell, TILE_CELLS, TILE_SIDE, TileKey};
use flockslam_geometry::Pose;

/// The evidence of a bounded stretch of travel, closed for good: the form in which everybody holds it.
///
/// Its cells lie in the lattice of the robot's odom frame (no rotation); `odom_from_submap` is the pose of the robot
/// at its first scan, and moving that reference pose moves the whole submap.
///
/// ```
/// use flockslam_evidence::{CellIndex, PackedCell, Submap, SubmapTile, TILE_CELLS};
/// use flockslam_geometry::Pose;
///
/// let wall = CellIndex::new(3, 5);
/// let mut cells = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
/// cells[wall.offset()] = PackedCell { occupied: 900, free: 20 };
/// let mut submap = Submap {
///     insertions: 1,
///     odom_from_submap: Pose::IDENTITY,
///     cell_size_m: 0.05,
///     tiles: vec![SubmapTile::new(wall.tile(), cells)],
///     ..Submap::default()
/// };
/// assert_eq!(Submap::decode(&submap.encode())?, submap.quantised());
/// // A cell that is found stale is masked; the evidence itself stays.
/// assert_eq!(submap.clear(wall).occupied, 900);
/// assert!(submap.cell(wall).is_unknown() && submap.has_cleared());
/// # Ok::<(), flockslam_evidence::SubmapBytesError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Submap {
    /// Its number within the run, from 0.
    pub number: u32,
    /// Trajectory that it belongs to: relative poses within a trajectory are known from driving.
    pub trajectory: u32,
    /// Scans in it.
    pub insertions: u32,
    /// Sequence of its first scan.
    pub first: u64,
    /// Sequence of its last scan.
    pub last: u64,
    /// Pose of the robot at the first scan: the reference pose.
    pub odom_from_submap: Pose,
    /// Side of a cell, metres.
    pub cell_size_m: f64,
    /// Tiles with evidence, sorted by key.
    pub tiles: Vec<SubmapTile>,
}

/// One tile of a [`Submap`].
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapTile {
    /// Which tile of the odom lattice.
    pub key: TileKey,
    /// Evidence as it was closed.
    pub cells: Box<[PackedCell; TILE_CELLS]>,
    /// Cells found stale afterwards, one bit each, row by row: they count as unknown.
    pub cleared: [u64; TILE_SIDE],
}

impl Submap {
    /// The tile with this key, if the submap has evidence there.
    pub fn tile(&self, key: TileKey) -> Option<&SubmapTile> {
        self.tiles.binary_search_by_key(&key, |tile| tile.key).ok().map(|place| &self.tiles[place])
    }

    /// The tile with this key, to mask cells of it.
    pub fn tile_mut(&mut self, key: TileKey) -> Option<&mut SubmapTile> {
        self.tiles.binary_search_by_key(&key, |tile| tile.key).ok().map(|place| &mut self.tiles[place])
    }

    /// Whether a cell was cleared after the submap was closed.
    pub fn has_cleared(&self) -> bool {
        self.tiles.iter().any(SubmapTile::has_cleared)
    }

    /// Area of its cells with evidence, cleared or not, m².
    pub fn known_area_m2(&self) -> f64 {
        let known = self.tiles.iter().flat_map(|tile| tile.cells.iter()).filter(|cell| !cell.is_unknown());
        known.count() as f64 * self.cell_size_m * self.cell_size_m
    }

    /// Evidence of a cell of the odom lattice; unknown where there is none or it was cleared.
    pub fn cell(&self, cell: CellIndex) -> PackedCell {
        self.tile(cell.tile()).map_or(PackedCell::UNKNOWN, |tile| tile.cell(cell.offset()))
    }

    /// Masks a cell and gives back the evidence that it had.
    pub fn clear(&mut self, cell: CellIndex) -> PackedCell {
        self.tile_mut(cell.tile()).map_or(PackedCell::UNKNOWN, |tile| tile.clear(cell.offset()))
    }
}

impl SubmapTile {
    /// A tile of these cells, none cleared.
    pub fn new(key: TileKey, cells: Box<[PackedCell; TILE_CELLS]>) -> Self {
        Self { key, cells, cleared: [0; TILE_SIDE] }
    }

    /// Evidence of the cell at `offset`; unknown when it was cleared.
    #[inline]
    pub fn cell(&self, offset: usize) -> PackedCell {
        if self.is_cleared(offset) { PackedCell::UNKNOWN } else { self.cells[offset] }
    }

    /// Whether the cell at `offset` is masked.
    #[inline]
    pub fn is_cleared(&self, offset: usize) -> bool {
        self.cleared[offset / TILE_SIDE] >> (offset % TILE_SIDE) & 1 == 1
    }

    /// Whether any cell is masked.
    pub fn has_cleared(&self) -> bool {
        self.cleared.iter().any(|row| *row != 0)
    }

    /// Masks the cell at `offset` and gives back the evidence that it had.
    pub fn clear(&mut self, offset: usize) -> PackedCell {
        let before = self.cell(offset);
        self.cleared[offset / TILE_SIDE] |= 1 << (offset % TILE_SIDE);
        before
    }
}
