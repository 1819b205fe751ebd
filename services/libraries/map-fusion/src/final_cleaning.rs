//! Which cells of the finished map stand occupied although scans have looked through them since: what is known at the end, when
//! all scans have their final poses, and was not when they were taken.

use crate::FusedMap;
use crate::rays::{BLOCK_SIDE, Rays};
use flockslam_evidence::{CellIndex, TILE_SIDE, TileKey, floor};
use flockslam_geometry::{Point, Pose};
use flockslam_messages::{Deskew, ScanView};
use flockslam_visibility::{Horizon, Margins, PassThrough, PolarRangeImage, Visibility};
use std::collections::BTreeMap;
use std::ops::Range;

/// Cells farther from the lidar are not judged, metres: beams are too far apart there.
const REACH_M: f64 = 12.0;
/// An object this near to a cell may be the one that was seen in it, cells.
const NEAR_CELLS: i32 = 2;
/// A beam passes a cell if it ends so far behind it, metres.
const PASSED_BEHIND_M: f64 = 0.3;
/// So many views through a cell, since it was last seen occupied, make it free …
pub const VIEWS: u8 = 3;
/// … or as many of beams through it alone, while none ends near, in so many scans that entered the map …
const SCANS: u8 = 2;
/// … or so many of them from anywhere, when something else stands near: then no wall gets a hole …
const PASSES: u8 = 2;
/// … each at least so long after the one before, nanoseconds.
pub const APART_NS: u64 = 300_000_000;
/// Scans that pass through more than this share of the judged cells have a wrong pose.
const CONTRADICTED_MAX: f64 = 0.2;
/// Blocks of cells along the side of a tile: those that a scan cannot see, nor cross, are passed over as wholes.
const BLOCKS_SIDE: usize = TILE_SIDE / BLOCK_SIDE as usize;
const BLOCKS: usize = BLOCKS_SIDE * BLOCKS_SIDE;
/// Final poses of scans are known this well among each other.
const MARGINS: Margins = Margins { behind_m: 0.15, behind_share: 0.015, beside_m: 0.06, beside_rad: 0.005 };

/// The occupied cells of a map, and their judgements by one scan after the other.
///
/// Memory is bounded by the number of these cells; each scan costs as much as there are within its reach.
#[derive(Debug)]
pub struct FinalCleaning {
    cell_size_m: f64,
    tiles: BTreeMap<TileKey, WatchedTile>,
    sight: PolarRangeImage,
    /// What the present scan cannot see.
    horizon: Horizon,
    /// Beams of the present scan.
    rays: Rays,
    /// Cells that a beam of the present scan passes, and whether all beams near do.
    through: Vec<(TileKey, usize, bool)>,
}

/// The occupied cells of a tile, block by block, and in each of these in the order of their offsets.
#[derive(Debug)]
struct WatchedTile {
    cells: Vec<Watched>,
    /// Where each block begins, and where the last one ends.
    starts: [u16; BLOCKS + 1],
}

impl WatchedTile {
    fn new(cells: impl Iterator<Item = Watched>) -> Self {
        let mut cells: Vec<_> = cells.collect();
        cells.shrink_to_fit();
        cells.sort_by_key(|watched| (block(watched.offset), watched.offset));
        let before = |number: usize| cells.partition_point(|watched| block(watched.offset) < number) as u16;
        Self { starts: std::array::from_fn(before), cells }
    }

    /// The places of the cells of a block.
    fn of_block(&self, number: usize) -> Range<usize> {
        usize::from(self.starts[number])..usize::from(self.starts[number + 1])
    }
}

/// The number of the block that a cell of a tile is in.
fn block(offset: u16) -> usize {
    let side = BLOCK_SIDE as usize;
    usize::from(offset) / TILE_SIDE / side * BLOCKS_SIDE + usize::from(offset) % TILE_SIDE / side
}

/// An occupied cell, and how often it was looked through since it was last seen to stand.
#[derive(Clone, Copy, Debug)]
struct Watched {
    /// Its offset in its tile.
    offset: u16,
    /// By scans of which all beams near it passed too.
    views: u8,
    /// By any scans.
    passes: u8,
    /// By so many scans, however many views each of them counts as.
    scans: u8,
    last_ns: i64,
}

impl FinalCleaning {
    /// Before the first scan.
    pub fn new(map: &FusedMap) -> Self {
        let occupied = |cells: &[flockslam_evidence::Cell]| {
            let occupied = cells.iter().enumerate().filter(|(_, cell)| cell.occupied > cell.free);
            let watch = |(offset, _)| Watched {
                offset: offset as u16,
                views: 0,
                passes: 0,
                scans: 0,
                last_ns: i64::MIN,
            };
            WatchedTile::new(occupied.map(watch))
        };
        let tiles = map.tiles().map(|(key, cells)| (key, occupied(&cells[..])));
        Self {
            cell_size_m: map.cell_size_m(),
            tiles: tiles.filter(|(_, tile)| !tile.cells.is_empty()).collect(),
            sight: PolarRangeImage::new(),
            horizon: Horizon::new(),
            rays: Rays::new(map.cell_size_m(), REACH_M, PASSED_BEHIND_M, NEAR_CELLS),
            through: Vec::new(),
        }
    }

    /// Takes in a scan at its final pose, which counts as so many views; in the order in which they were taken.
    pub fn look(&mut self, scan: ScanView<'_>, deskew: &Deskew, map_from_base: Pose, views: u8) {
        let map_from_laser = map_from_base * scan.header().base_from_laser;
        self.sight.look(scan, deskew);
        self.horizon.look(&self.sight, map_from_laser.heading_rad, self.cell_size_m);
        self.rays.look(scan, deskew, map_from_base, map_from_laser.position());
        let view = PassThrough::new(&self.sight, map_from_laser, self.cell_size_m, MARGINS)
            .with_horizon(&self.horizon);
        let (at, size_m) = (map_from_laser.position(), self.cell_size_m);
        let tile = |metres: f64| floor(metres / (size_m * TILE_SIDE as f64));
        let rows = tile(at.y_m - REACH_M)..=tile(at.y_m + REACH_M);
        let (left, right) = (tile(at.x_m - REACH_M), tile(at.x_m + REACH_M));
        self.through.clear();
        let (mut supported, mut seen_through) = (0, 0);
        for key in rows.flat_map(|y| (left..=right).map(move |x| TileKey { x, y })) {
            let Some(tile) = self.tiles.get_mut(&key) else { continue };
            for number in 0..BLOCKS {
                let places = tile.of_block(number);
                let first = key.cell(block_offset(number));
                let last =
                    CellIndex::new(first.x.saturating_add(BLOCK_SIDE), first.y.saturating_add(BLOCK_SIDE));
                let seen = |corner: CellIndex| {
                    Point::new(f64::from(corner.x) * size_m - at.x_m, f64::from(corner.y) * size_m - at.y_m)
                };
                if places.is_empty()
                    || (!self.rays.have_touched_block_of(first)
                        && self.horizon.hides_all(seen(first), seen(last)))
                {
                    continue;
                }
                for place in places {
                    let watched = &mut tile.cells[place];
                    let cell = key.cell(usize::from(watched.offset));
                    let center = center(cell, size_m);
                    if center.distance_m(at) > REACH_M {
                        continue;
                    }
                    let (is_end_near, is_crossed) = self.rays.at(cell);
                    if is_end_near {
                        (watched.passes, watched.scans) = (0, 0);
                    }
                    match view.judge(center) {
                        Visibility::SeenThrough => {
                            seen_through += 1;
                            self.through.push((key, place, true));
                            continue;
                        }
                        Visibility::Supported | Visibility::Touched => {
                            supported += 1;
                            watched.views = 0;
                        }
                        Visibility::Passed | Visibility::Open => (),
                    }
                    if !is_end_near && is_crossed {
                        self.through.push((key, place, false));
                    }
                }
            }
        }
        let judged = f64::from(seen_through + supported);
        if f64::from(seen_through) <= CONTRADICTED_MAX * judged {
            self.count(scan.header().times.sensor_ns, views);
        }
    }

    fn count(&mut self, now_ns: i64, views: u8) {
        for (key, place, is_clear) in &self.through {
            let watched = self.tiles.get_mut(key).map(|tile| &mut tile.cells[*place]);
            if let Some(watched) = watched.filter(|watched| now_ns.abs_diff(watched.last_ns) >= APART_NS) {
                watched.views = watched.views.saturating_add(views * u8::from(*is_clear));
                watched.passes = watched.passes.saturating_add(views);
                watched.scans = watched.scans.saturating_add(1);
                watched.last_ns = now_ns;
            }
        }
    }

    /// The cells that are free by now, in a fixed order: those that were seen through clearly, and those that were passed so often
    /// if something else stands near, so that no wall gets a hole.
    pub fn free(&self) -> Vec<CellIndex> {
        let is_free = |watched: &Watched, cell: CellIndex| {
            watched.views >= VIEWS
                || (watched.passes >= VIEWS && watched.scans >= SCANS)
                || (watched.passes >= PASSES && self.something_stands_near(cell))
        };
        let free_of = |(key, tile): (&TileKey, &WatchedTile)| {
            let cells = tile.cells.iter().map(|watched| (watched, key.cell(usize::from(watched.offset))));
            cells.filter(|(watched, cell)| is_free(watched, *cell)).map(|(_, cell)| cell).collect::<Vec<_>>()
        };
        self.tiles.iter().flat_map(free_of).collect()
    }

    /// Whether another cell beside this one is not looked through.
    fn something_stands_near(&self, cell: CellIndex) -> bool {
        let around = -NEAR_CELLS..=NEAR_CELLS;
        around.clone().flat_map(|dy| around.clone().map(move |dx| (dx, dy))).any(|(dx, dy)| {
            let near = CellIndex::new(cell.x.saturating_add(dx), cell.y.saturating_add(dy));
            self.watched(near).is_some_and(|watched| watched.passes < PASSES)
        })
    }

    fn watched(&self, cell: CellIndex) -> Option<&Watched> {
        let tile = self.tiles.get(&cell.tile())?;
        let block = &tile.cells[tile.of_block(block(cell.offset() as u16))];
        let place = block.binary_search_by_key(&cell.offset(), |watched| usize::from(watched.offset));
        place.ok().map(|place| &block[place])
    }
}

/// The offset of the first cell of a block.
fn block_offset(number: usize) -> usize {
    (number / BLOCKS_SIDE * TILE_SIDE + number % BLOCKS_SIDE) * BLOCK_SIDE as usize
}

fn center(cell: CellIndex, cell_size_m: f64) -> Point {
    let middle = |index: i32| (f64::from(index) + 0.5) * cell_size_m;
    Point::new(middle(cell.x), middle(cell.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_evidence::{PackedCell, Submap, SubmapTile, TILE_CELLS};
    use flockslam_geometry::Twist;
    use flockslam_messages::ScanBuffer;

    const CELL_M: f64 = 0.05;
    /// The inner side of the walls around the room, cells from the middle.
    const WALL: i32 = 59;
    /// Its occupied cells: indices along x and y.
    const COLUMN: std::ops::Range<i32> = 24..28;

    fn is_column(cell: CellIndex) -> bool {
        COLUMN.contains(&cell.x) && COLUMN.contains(&cell.y)
    }

    /// A room of 6 × 6 m with a column in it.
    fn room() -> FusedMap {
        let tile = |(x, y): (i32, i32)| {
            let key = TileKey { x, y };
            let cell = |offset| {
                let cell = key.cell(offset);
                let far = [cell.x, cell.y].map(|index| index.max(-1 - index)).into_iter().max();
                match far.map_or(0, |far| far.cmp(&WALL) as i32) {
                    0 => PackedCell { occupied: 9000, free: 0 },
                    _ if is_column(cell) => PackedCell { occupied: 9000, free: 3000 },
                    -1 => PackedCell { occupied: 0, free: 5000 },
                    _ => PackedCell::UNKNOWN,
                }
            };
            SubmapTile::new(key, Box::new(std::array::from_fn::<_, TILE_CELLS, _>(cell)))
        };
        let submap = Submap {
            cell_size_m: CELL_M,
            tiles: [(-1, -1), (0, -1), (-1, 0), (0, 0)].map(tile).into_iter().collect(),
            ..Submap::default()
        };
        let mut map = FusedMap::new(CELL_M);
        map.add(&submap, Pose::IDENTITY).unwrap();
        map
    }

    /// Distance to the walls, and to the column if it is there, from `pose` in each of 360 directions.
    fn scan(number: i64, pose: Pose, column: bool) -> ScanBuffer {
        let solid = |x: f64, y: f64| {
            let index = |metres: f64| floor(metres / CELL_M);
            let cell = CellIndex::new(index(x), index(y));
            x.abs().max(y.abs()) >= f64::from(WALL) * CELL_M || (column && is_column(cell))
        };
        let range = |beam: i32| {
            let (sin, cos) = (pose.heading_rad + f64::from(beam).to_radians()).sin_cos();
            let ahead = |step: i32| 0.005 * f64::from(step);
            let hit =
                (0..2000).find(|step| solid(pose.x_m + ahead(*step) * cos, pose.y_m + ahead(*step) * sin));
            ahead(hit.unwrap()) as f32
        };
        let mut scan =
            ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians());
        scan.header.times.sensor_ns = number * 400_000_000;
        scan
    }

    fn pose(number: i64) -> Pose {
        Pose::new(0.1 * number as f64 - 0.6, -0.7, 0.3 * number as f64)
    }

    fn look(final_cleaning: &mut FinalCleaning, number: i64, column: bool, displaced: Pose) {
        let scan = scan(number, pose(number), column);
        let view = scan.view().unwrap();
        final_cleaning.look(view, &Deskew::new(view, Twist::default()), displaced * pose(number), 1);
    }

    #[test]
    fn what_scans_have_looked_through_since_is_free_and_the_walls_stand() {
        let map = room();
        let mut final_cleaning = FinalCleaning::new(&map);
        (0..5).for_each(|number| look(&mut final_cleaning, number, true, Pose::IDENTITY));
        assert_eq!(final_cleaning.free(), []);
        (5..7).for_each(|number| look(&mut final_cleaning, number, false, Pose::IDENTITY));
        assert_eq!(final_cleaning.free(), [], "two views are too few");
        look(&mut final_cleaning, 7, false, Pose::IDENTITY);
        let column = COLUMN.flat_map(|y| COLUMN.map(move |x| CellIndex::new(x, y)));
        let mut free = final_cleaning.free();
        free.sort_by_key(|cell| (cell.y, cell.x));
        assert_eq!(free, column.collect::<Vec<_>>());
        // It is back.
        look(&mut final_cleaning, 8, true, Pose::IDENTITY);
        assert!(final_cleaning.free().len() < 12, "what is seen again stands: {:?}", final_cleaning.free());
    }

    #[test]
    fn scans_in_the_wrong_place_and_scans_at_one_time_free_nothing() {
        let map = room();
        let mut displaced = FinalCleaning::new(&map);
        (0..9).for_each(|number| look(&mut displaced, number, false, Pose::new(0.5, 0.5, 0.0)));
        assert_eq!(displaced.free(), []);
        let mut at_once = FinalCleaning::new(&map);
        (0..9).for_each(|_| look(&mut at_once, 4, false, Pose::IDENTITY));
        assert_eq!(at_once.free(), []);
    }
}
