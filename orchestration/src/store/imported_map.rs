//! Makes a saved map of an imported map: its cells as submaps, and what a lidar would see in it as scans at poses that are given.
//!
//! A picture has neither scans nor submaps, and loops are closed with scans. So places to look from are spread over its free space, and the
//! journal holds what would be seen from each. The submaps hold the cells of the picture itself.

use super::plan_views::Plan;
use super::{MapHead, StoreError};
use flockslam_evidence::{CellIndex, PackedCell, Submap, SubmapTile, TILE_CELLS, TileKey, floor};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer, ScanId};
use flockslam_results::{StoredMap, SubmapStore};
use flockslam_stage::JournalWriter;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Tiles along a side of the block that makes a submap.
const BLOCK_TILES: i32 = 4;
/// Name of the map's author.
const MAKER: &str = "imported";

/// What was imported.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imported {
    /// Area of all cells that are free or occupied, m².
    pub area_m2: f64,
    /// Number of submaps.
    pub submaps: u32,
    /// Places from which it is seen.
    pub views: usize,
}

/// A block of tiles: row, then column.
type Block = (i32, i32);

/// A part of the map that becomes a submap.
#[derive(Default)]
struct Part {
    views: Vec<(Pose, ScanBuffer)>,
    tiles: Vec<SubmapTile>,
}

/// Writes a saved map with the cells of `map`, in cells of this side, metres, into a directory. The head is written last: what is not whole
/// is no map.
///
/// # Errors
/// When the directory holds a map, there is no wall to be seen in it, or the disk refuses.
pub fn import_map(map: &StoredMap, directory: &Path, cell_size_m: f64) -> Result<Imported, StoreError> {
    if !matches!(MapHead::read(directory), Err(StoreError::Absent(_))) {
        return Err(StoreError::Taken(directory.to_owned()));
    }
    let plan = Plan::new(map);
    let mut parts: BTreeMap<Block, Part> = BTreeMap::new();
    for (pose, scan) in plan.views() {
        parts.entry(block_of(pose.position(), cell_size_m)).or_default().views.push((pose, scan));
    }
    if parts.is_empty() {
        return Err(StoreError::Bare);
    }
    for tile in tiles(&plan, cell_size_m) {
        let block = nearest(&parts, (tile.key.y.div_euclid(BLOCK_TILES), tile.key.x.div_euclid(BLOCK_TILES)));
        parts.entry(block).or_default().tiles.push(tile);
    }
    let store_dir = directory.join("submaps");
    fs::create_dir_all(&store_dir).map_err(StoreError::io(&store_dir))?;
    let (store, mut journal) = (SubmapStore::new(&store_dir), JournalWriter::open(directory)?);
    let mut imported = Imported { area_m2: 0.0, submaps: 0, views: 0 };
    for part in parts.into_values() {
        let submap = write(part, &imported, cell_size_m, &mut journal)?;
        store.save(&submap).map_err(flockslam_stage::StageError::from)?;
        imported.area_m2 += submap.known_area_m2();
        imported.submaps += 1;
        imported.views += submap.insertions as usize;
    }
    MapHead::of_this_build(MAKER, cell_size_m).write(directory)?;
    Ok(imported)
}

/// Appends the views of a part to the journal, and gives its submap.
fn write(
    mut part: Part,
    before: &Imported,
    cell_size_m: f64,
    journal: &mut JournalWriter,
) -> Result<Submap, StoreError> {
    let (number, first) = (before.submaps, before.views as u64);
    let odom_from_submap = part.views[0].0;
    let insertions = part.views.len() as u32;
    for (sequence, (pose, scan)) in (first..).zip(&mut part.views) {
        let id = ScanId { run: 1, lidar: 0, sequence };
        scan.header.id = id;
        let pose = PoseEstimate {
            id,
            odom_from_base: *pose,
            generation: sequence + 1,
            score: 1.0,
            submap: number,
            flags: PoseFlags::MATCHED | PoseFlags::INSERT | PoseFlags::IMPORTED,
            ..PoseEstimate::default()
        };
        journal.append(&pose, scan.view().expect("a view is a scan"))?;
    }
    part.tiles.sort_unstable_by_key(|tile| tile.key);
    Ok(Submap {
        number,
        trajectory: 0,
        insertions,
        first,
        last: first + u64::from(insertions) - 1,
        odom_from_submap,
        cell_size_m,
        tiles: part.tiles,
    })
}

/// The block that a place is in.
fn block_of(at: Point, cell_size_m: f64) -> Block {
    let cell = CellIndex::new(floor(at.x_m / cell_size_m), floor(at.y_m / cell_size_m));
    let key = cell.tile();
    (key.y.div_euclid(BLOCK_TILES), key.x.div_euclid(BLOCK_TILES))
}

/// The block with views that is nearest to one.
fn nearest(parts: &BTreeMap<Block, Part>, to: Block) -> Block {
    let away = |block: &&Block| {
        let (dy, dx) = (i64::from(block.0 - to.0), i64::from(block.1 - to.1));
        dy * dy + dx * dx
    };
    *parts.keys().min_by_key(away).expect("a map has views")
}

/// The tiles of the map's lattice in which something is known.
fn tiles(plan: &Plan, cell_size_m: f64) -> Vec<SubmapTile> {
    let (low, high) = plan.corners();
    let key = |at: Point| CellIndex::new(floor(at.x_m / cell_size_m), floor(at.y_m / cell_size_m)).tile();
    let (low, high) = (key(low), key(high));
    let mut tiles = Vec::new();
    for y in low.y..=high.y {
        for x in low.x..=high.x {
            let key = TileKey { x, y };
            let mut cells = Box::new([PackedCell::UNKNOWN; TILE_CELLS]);
            for (offset, cell) in cells.iter_mut().enumerate() {
                let index = key.cell(offset);
                let middle = |cell: i32| (f64::from(cell) + 0.5) * cell_size_m;
                let at = Point::new(middle(index.x), middle(index.y));
                *cell = super::nav2_map::evidence(plan.state_around(at, cell_size_m)).pack();
            }
            if cells.iter().any(|cell| !cell.is_unknown()) {
                tiles.push(SubmapTile::new(key, cells));
            }
        }
    }
    tiles
}
